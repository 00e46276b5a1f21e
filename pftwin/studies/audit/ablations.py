"""What a scene can do without, as variants of it: its effects say what they can be without."""

from __future__ import annotations

from collections.abc import Iterable

import jax

from pftwin.model.effects.base import Change
from pftwin.model.scene import Scene
from pftwin.studies.audit.femur_inertia import without_femur_inertia
from pftwin.studies.audit.parts import parts
from pftwin.studies.audit.variant import Kind, NotApplicable, Variant


def ablations(scene: Scene) -> list[Variant | NotApplicable]:
    """Each effect, what effects can be without, and what the femur's motion adds."""
    found: list[Variant | NotApplicable] = [
        Variant(p.name, "left out", f"the scene without {p.name} ({p.kind})", p.without) for p in parts(scene)
    ]
    shared = (c for e in scene.effects for c in e.simplifications() if c.memory is None)
    return [*found, *together(scene, "left out", shared), without_femur_inertia(scene)]


def together(scene: Scene, kind: Kind, changes: Iterable[Change]) -> list[Variant]:
    """A variant for each label, with all effects changed that have a change of that label."""
    groups: dict[str, list[Change]] = {}
    for change in changes:
        groups.setdefault(change.label, []).append(change)
    found = []
    for label, group in groups.items():
        changed = scene
        for c in group:
            changed = changed.with_effect(c.effect)
        sentence = f"{', '.join(c.effect.name for c in group)}: {group[0].how}"
        alike = jax.tree.structure(changed) == jax.tree.structure(scene)
        found.append(Variant(label, kind, sentence, changed, alike))
    return found
