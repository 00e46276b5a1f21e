"""A scene: the patella as a rigid body, the guided motion, and the effects that act on the patella."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from pftwin.base.errors import InputError
from pftwin.base.quantities import bounded_leaves, declarations, quantity
from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.geometry.patch.closest import Surface
from pftwin.model.effects.base import Effect, Reported
from pftwin.model.limits import Limits, check_limits
from pftwin.model.motion import KneeMotion
from pftwin.model.scene_parameters import get_value, with_value

if TYPE_CHECKING:
    from pftwin.model.drawn_bones import DrawnBones
    from pftwin.model.effects.contact import Contact
    from pftwin.model.measured import Measured


class PatellaBody(eqx.Module):
    """The patella as a rigid body. Points of the patella are given in the patella's frame."""

    mass: Scalar = eqx.field(metadata=quantity("kg", positive=True))
    inertia: Vec3 = eqx.field(metadata=quantity("kg m^2", positive=True))  # principal, about the centre of mass
    center_of_mass: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))


class Scene(eqx.Module):
    """Everything a simulation needs. Parameters are leaves (vmap, jvp and grad reach every one of them); which effects
    there are, and how many contacts, strands and frames, is structure.
    """

    patella: PatellaBody
    effects: tuple[Effect, ...]
    motion: KneeMotion
    start: Pose  # of the patella frame in the world at the first frame: where the search for equilibrium begins
    name: str = eqx.field(static=True, default="scene")
    synthetic: bool = eqx.field(static=True, default=False)  # whether its motion was made up; outputs say so
    # Measurements of this motion, if any. A treated knee moves differently, so treatments drop them.
    measured: Measured | None = eqx.field(static=True, default=None)
    limits: Limits | None = eqx.field(static=True, default=None)  # what a knee can be; None: it may be any body
    bones: DrawnBones | None = eqx.field(static=True, default=None)  # for drawings; None: these show schematic ones

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

    def reported(self, name: str) -> Reported:
        """What an effect reports, by "EFFECT.OBSERVABLE": "contact.force_medial".

        Raises:
            InputError: no such effect, or one that does not report this.
        """
        return Reported.of(name, {e.name: type(e).observables for e in self.effects}, self.name)

    def with_effect(self, effect: Effect) -> Scene:
        """The scene with this effect in place of the one of the same name, or added at the end."""
        names = [e.name for e in self.effects]
        effects = list(self.effects)
        if effect.name in names:
            effects[names.index(effect.name)] = effect
        else:
            effects.append(effect)
        return dataclasses.replace(self, effects=tuple(effects))

    def without(self, name: str) -> Scene:
        """The scene without one effect."""
        gone = self.effect(name)
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if e is not gone))

    def unnamed(self) -> Scene:
        """The scene without what no program depends on, as names, measurements and limits: like scenes share one."""
        return dataclasses.replace(self, name="", synthetic=False, measured=None, limits=None, bones=None)

    def with_limits(self, **limits: float) -> Scene:
        """The scene as a knee, whose numbers `check` keeps within limits; any of them can be set by name.

        Raises:
            InputError: no such limit (`pftwin.model.limits.Limits`).
        """
        return dataclasses.replace(self, limits=Limits.of(limits))

    @property
    def contact(self) -> Contact | None:
        """The contact between button and femur that results follow, whatever its geometry; None where there is none."""
        return next((role for e in self.effects if (role := e.contact_role()) is not None), None)

    @property
    def surface(self) -> Surface | None:
        """The surface of the contact, or its smooth stand-in; None where there is none."""
        return None if self.contact is None else self.contact.groove_surface()

    def tracked_point(self) -> Vec3:
        """The point of the patella whose path results show: the button's centre, else the patella's origin."""
        return Vec3.zero() if self.contact is None else self.contact.tracked_point()

    def get(self, name: str) -> Any:
        """A number, an array or a vector (`Vec3`) of the scene by its name: "K1", "quadriceps.origin", "patella.mass".

        Raises:
            InputError: no such number, with the nearest name that there is.
        """
        return get_value(self, name)

    def set(self, name: str, value: Any) -> Scene:
        """The scene with another value under a name, in SI units: of the field's shape; of a vector such as
        "quadriceps.origin" a `Vec3` or an array (..., 3). Pure: jit, vmap and derivatives apply.

        Raises:
            InputError: no such number; a value of another shape.
        """
        return with_value(self, name, value)

    def center_of_mass_pose(self) -> Pose:
        """The start pose of the centre of mass."""
        return Pose(self.start.apply(self.patella.center_of_mass), self.start.orientation)


def check(scene: Scene) -> None:
    """Refuses a scene whose parameters cannot give a right answer; on the host, before anything is traced.

    Raises:
        InputError: a parameter that is not finite, or not positive where it must be, by its path in the scene; two
            effects of one name; in a scene that has limits, a number beyond them.
    """
    names = [e.name for e in scene.effects]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two effects are named {name!r}", where=scene.name, remedy="give each its own name")
    leaves, structure = jax.tree.flatten(scene)
    values = [np.ones(0) if isinstance(a, Tracer) else np.asarray(a, dtype=float).ravel() for a in leaves]
    # All at once, since this runs before every simulation; only a failure is traced to its parameter.
    fine = bool(np.isfinite(np.concatenate([*values, np.ones(1)])).all())
    for declared, which in bounded_leaves(structure):
        fine = fine and declared.offender(np.concatenate([values[i] for i in which])) is None
    if not fine:
        _refuse(scene)
    if scene.limits is not None and not any(isinstance(leaf, Tracer) for leaf in leaves):
        check_limits(scene, scene.limits)


def _refuse(scene: Scene) -> None:
    """Names the first parameter that is wrong."""
    for path, leaf, declared in declarations(scene):
        if isinstance(leaf, Tracer):
            continue
        values = np.asarray(leaf, dtype=float)
        parts = [scene.effects[int(path[1])].name, *path[2:]] if path[0] == "effects" else path
        where = f"{scene.name}: {'.'.join(parts)}"
        if not np.all(np.isfinite(values)):
            raise InputError("not a finite number", where=where)
        if declared is not None and (worst := declared.offender(values)) is not None:
            raise InputError(f"found {worst:g}", where=where, expected=declared.expected)
