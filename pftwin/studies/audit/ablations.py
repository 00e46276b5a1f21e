"""What a scene can do without, as variants of it."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from pftwin.effects.strands import StrandGroup
from pftwin.effects.tendon import Tendon
from pftwin.effects.toe_tendon import ToeTendon
from pftwin.scene import Scene
from pftwin.studies.audit.femur_inertia import without_femur_inertia
from pftwin.studies.audit.parts import parts
from pftwin.studies.audit.variant import NotApplicable, Variant

_NO_TOE = 1e-6  # strain at which the toe ends: as good as none
TOE = "toe region"


def ablations(scene: Scene) -> list[Variant | NotApplicable]:
    """Each effect, the friction of contacts, toe regions, the tendons' damping, and what the femur's motion adds."""
    found: list[Variant | NotApplicable] = [
        Variant(p.name, "left out", f"the scene without {p.name} ({p.kind})", p.without) for p in parts(scene)
    ]
    found += [v for v in (_toes_of_tendons(scene), _toes_of_strands(scene), _damping(scene)) if v is not None]
    return [*found, without_femur_inertia(scene)]


def _changed(scene: Scene, change: Any) -> Scene:
    """The scene with every effect changed for which `change` has an answer."""
    effects = tuple(new if (new := change(e)) is not None else e for e in scene.effects)
    return dataclasses.replace(scene, effects=effects)


def _toes_of_tendons(scene: Scene) -> Variant | None:
    """Toe tendons as linear ones of the same linear region: the line meets zero half a toe later."""

    def linear(e: Any) -> Tendon | None:
        if not isinstance(e, ToeTendon):
            return None
        slack = e.slack_length * (1 + 0.5 * e.toe_strain)
        return Tendon(e.stiffness, slack, e.damping, e.insertion, e.origin, e.body, name=e.name)

    names = [e.name for e in scene.effects if isinstance(e, ToeTendon)]
    if not names:
        return None
    return Variant(
        f"{TOE} of tendons", "left out", f"{', '.join(names)} linear from slack, the linear region as it is",
        _changed(scene, linear),
    )  # fmt: skip


def _toes_of_strands(scene: Scene) -> Variant | None:
    """Strands without a toe region, their stiffness per metre and their linear region as they are."""

    def linear(e: Any) -> StrandGroup | None:
        if not isinstance(e, StrandGroup):
            return None
        longer = (1 + 0.5 * e.toe_strain) / (1 + 0.5 * _NO_TOE)
        new = e.stiffness * longer, e.slack_length * longer, jnp.full_like(e.toe_strain, _NO_TOE)
        return eqx.tree_at(lambda s: (s.stiffness, s.slack_length, s.toe_strain), e, new)

    names = [e.name for e in scene.effects if isinstance(e, StrandGroup)]
    if not names:
        return None
    sentence = f"strands of {', '.join(names)} linear from slack, the linear region as it is"
    return Variant(f"{TOE} of strands", "left out", sentence, _changed(scene, linear), alike=True)


def _damping(scene: Scene) -> Variant | None:
    """Tendons and strands without their dashpots."""

    def undamped(e: Any) -> Any:
        for field in ("damping", "damping_time"):
            if hasattr(e, "line") and hasattr(e, field):
                return eqx.tree_at(lambda s: getattr(s, field), e, jnp.zeros_like(getattr(e, field)))  # noqa: B023
        return None

    names = [e.name for e in scene.effects if undamped(e) is not None]
    if not names:
        return None
    sentence = f"no dashpots in {', '.join(names)}"
    return Variant("tendons' damping", "left out", sentence, _changed(scene, undamped), alike=True)
