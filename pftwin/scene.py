"""A scene: what is there. The patella as a rigid body, the guided motion, and the effects that act."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from pftwin.dynamics.state import System
from pftwin.effects.base import Effect
from pftwin.effects.sphere_contact import SphereContact
from pftwin.errors import InputError
from pftwin.motion import KneeMotion
from pftwin.spatial import Pose, Scalar, Vec3
from pftwin.surfaces.closest import Surface

if TYPE_CHECKING:
    from pftwin.measured import Measured

E = TypeVar("E", bound=Effect)


class PatellaBody(eqx.Module):
    """The patella as a rigid body. Points of the patella are given in the patella's frame."""

    mass: Scalar  # [kg]
    inertia: Vec3  # principal moments about the centre of mass, along the patella's axes [kg m^2]
    center_of_mass: Vec3  # patella frame [m]


class Scene(eqx.Module):
    """Everything a simulation needs. Parameters are leaves (vmap, jvp and grad reach every one of them); which effects
    there are, and how many contacts, strands and frames, is structure.
    """

    patella: PatellaBody
    effects: tuple[Effect, ...]
    motion: KneeMotion
    start: Pose  # of the patella frame in the world at the first frame: where the search for equilibrium begins
    name: str = eqx.field(static=True, default="scene")
    synthetic: bool = eqx.field(static=True, default=False)  # whether its motion was made up: all that shows it says so
    # What was measured of this motion; None where nothing was. A treated knee's is another motion: treatments drop it.
    measured: Measured | None = eqx.field(static=True, default=None)

    def effect(self, name: str) -> Effect:
        """The effect of that name.

        Raises:
            InputError: no such effect.
        """
        for effect in self.effects:
            if effect.name == name:
                return effect
        known = ", ".join(e.name for e in self.effects) or "none"
        raise InputError(f"no effect {name!r} in scene {self.name!r}", expected=f"one of: {known}")

    def index(self, name: str) -> int:
        """The place of an effect in `effects`."""
        return self.effects.index(self.effect(name))

    def with_effect(self, effect: Effect) -> Scene:
        """The scene with this effect in the place of the one of the same name, or added at the end."""
        names = [e.name for e in self.effects]
        effects = list(self.effects)
        if effect.name in names:
            effects[names.index(effect.name)] = effect
        else:
            effects.append(effect)
        return dataclasses.replace(self, effects=tuple(effects))

    def without(self, name: str) -> Scene:
        """The scene less one effect."""
        gone = self.effect(name)
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if e is not gone))

    def unnamed(self) -> Scene:
        """The scene without what is no part of a program: scenes of one structure share what is compiled."""
        return dataclasses.replace(self, name="", synthetic=False, measured=None)

    @property
    def contact(self) -> SphereContact | None:
        """The first contact of a sphere with a smooth surface; None where there is none."""
        return next((e for e in self.effects if isinstance(e, SphereContact)), None)

    @property
    def button(self) -> Effect | None:
        """The first effect with a point that results follow: the button's contact, whatever its geometry."""
        return next((e for e in self.effects if e.followed() is not None), None)

    @property
    def surface(self) -> Surface | None:
        """The surface of the contact, or its smooth stand-in; None where there is none."""
        return getattr(self.button, "surface", None)

    def tracked_point(self) -> Vec3:
        """The point of the patella whose path results show: the button's centre, else the patella's origin."""
        followed = None if self.button is None else self.button.followed()
        return Vec3.zero() if followed is None else followed

    def system(self) -> System:
        """The equations' view of the scene: points counted from the centre of mass."""
        about = tuple(e.about(self.patella.center_of_mass) for e in self.effects)
        return System(self.patella.mass, self.patella.inertia, about)

    def center_of_mass_pose(self) -> Pose:
        """The start pose of the centre of mass."""
        return Pose(self.start.apply(self.patella.center_of_mass), self.start.orientation)


_POSITIVE = {
    "mass",
    "inertia",
    "stiffness",
    "slack_length",
    "radius",
    "contact_stiffness",
    "restitution",
    "toe_strain",
    "half_size",
    "relaxation_time",
    "slip_speed",
    "effective_radius",
}
_NOT_NEGATIVE = {
    "coefficient",
    "damping",
    "damping_time",
    "dissipation",
    "maxwell_stiffness",
    "translational",
    "rotational",
    "tension",
}
LIMITS = {  # beyond which a law has no sense: bounces that grow, a stiffness without bound where contact begins
    "restitution": (0.0, 1.0, "at most 1"),
    "hertz_exponent": (1.0, np.inf, "at least 1"),
}


def check(scene: Scene) -> None:
    """Refuses a scene whose parameters cannot give a right answer; on the host, before anything is traced.

    Raises:
        InputError: a parameter that is not finite, or not positive where it must be, by its path in the scene; two
            effects of one name.
    """
    names = [e.name for e in scene.effects]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two effects are named {name!r}", where=scene.name, remedy="give each its own name")
    leaves, structure = jax.tree.flatten(scene)
    values = [np.ones(0) if isinstance(a, Tracer) else np.asarray(a, dtype=float).ravel() for a in leaves]
    positive, not_negative, bounded = limited(structure)
    # All at once, for this is done before every run; what is wrong is looked for where something is.
    finite = np.isfinite(np.concatenate([*values, np.ones(1)])).all()
    smallest, least = (
        np.concatenate([*(values[i] for i in which), np.ones(1)]).min() for which in (positive, not_negative)
    )
    outside = any(not _within(values[i], *LIMITS[name][:2]) for i, name in bounded)
    if outside or not (finite and smallest > 0 and least >= 0):
        _refuse(scene)


@lru_cache(maxsize=64)
def limited(structure: Any) -> tuple[tuple[int, ...], tuple[int, ...], tuple[tuple[int, str], ...]]:
    """Which leaves of a scene of this structure must be positive, which not negative, and which are in `LIMITS`."""
    numbered = jax.tree.unflatten(structure, range(structure.num_leaves))
    fields = [({_part(p) for p in path}, i) for path, i in jax.tree_util.tree_leaves_with_path(numbered)]
    positive, not_negative = (tuple(i for parts, i in fields if parts & limit) for limit in (_POSITIVE, _NOT_NEGATIVE))
    bounded = tuple((i, name) for parts, i in fields for name in LIMITS if name in parts)
    return positive, not_negative, bounded


def _within(values: np.ndarray, low: float, high: float) -> bool:
    return bool(np.all((values >= low) & (values <= high)))


def _refuse(scene: Scene) -> None:
    """Names the first parameter that is wrong."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(scene):
        if isinstance(leaf, Tracer):
            continue
        values, parts = np.asarray(leaf, dtype=float), [_part(p) for p in path]
        if parts[0] == "effects":
            parts = [scene.effects[path[1].idx].name, *parts[2:]]
        field = ".".join(str(p) for p in parts)
        if not np.all(np.isfinite(values)):
            raise InputError("not a finite number", where=f"{scene.name}: {field}")
        worst = float(values.min(initial=np.inf))
        if _POSITIVE & set(parts) and not worst > 0:
            raise InputError(f"found {worst:g}", where=f"{scene.name}: {field}", expected="a positive number")
        if _NOT_NEGATIVE & set(parts) and worst < 0:
            raise InputError(f"found {worst:g}", where=f"{scene.name}: {field}", expected="zero or a positive number")
        for name, (low, high, words) in LIMITS.items():
            if name in parts and not _within(values, low, high):
                found = float(values.max() if high < np.inf else worst)
                raise InputError(f"found {found:g}", where=f"{scene.name}: {field}", expected=words)


def _part(key: object) -> object:
    return getattr(key, "name", getattr(key, "idx", getattr(key, "key", key)))
