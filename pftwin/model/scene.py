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
    """The patella as a rigid body. Its points are given in the patella frame."""

    mass: Scalar = eqx.field(metadata=quantity("kg", positive=True))
    inertia: Vec3 = eqx.field(metadata=quantity("kg m^2", positive=True))  # principal, about the centre of mass
    center_of_mass: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))


class Scene(eqx.Module):
    """A complete model to simulate. Its parameters are leaves, so vmap, jvp and grad apply to all of them; the kinds of
    effects and the numbers of contacts, strands and frames are static structure.
    """

    patella: PatellaBody
    effects: tuple[Effect, ...]
    motion: KneeMotion
    start: Pose  # of the patella frame in the world at the first frame: initial guess of the search for equilibrium
    name: str = eqx.field(static=True, default="scene")
    synthetic: bool = eqx.field(static=True, default=False)  # whether the motion is synthetic, which outputs state
    # Measurements of this motion, if any. Treatments drop them, since a treated knee moves differently.
    measured: Measured | None = eqx.field(static=True, default=None)
    limits: Limits | None = eqx.field(static=True, default=None)  # plausible ranges for a knee; None: no limits
    bones: DrawnBones | None = eqx.field(static=True, default=None)  # for drawings only; None: schematic bones
    left: bool = eqx.field(static=True, default=False)  # whether it is the mirror image of a left knee

    def effect(self, name: str) -> Effect:
        """The effect named `name`.

        Raises:
            InputError: there is no such effect.
        """
        for effect in self.effects:
            if effect.name == name:
                return effect
        known = ", ".join(e.name for e in self.effects) or "none"
        raise InputError(f"no effect {name!r} in scene {self.name!r}", expected=f"one of: {known}")

    def index(self, name: str) -> int:
        """Index in `effects` of the effect named `name`."""
        return self.effects.index(self.effect(name))

    def reported(self, name: str) -> Reported:
        """Looks up an observable by "EFFECT.OBSERVABLE", e.g. "contact.force_medial".

        Raises:
            InputError: there is no such effect, or it does not report this observable.
        """
        return Reported.of(name, {e.name: type(e).observables for e in self.effects}, self.name)

    def with_effect(self, effect: Effect) -> Scene:
        """The scene with `effect` in place of the one with the same name, or appended."""
        names = [e.name for e in self.effects]
        effects = list(self.effects)
        if effect.name in names:
            effects[names.index(effect.name)] = effect
        else:
            effects.append(effect)
        return dataclasses.replace(self, effects=tuple(effects))

    def without(self, name: str) -> Scene:
        """The scene without the effect named `name`."""
        removed = self.effect(name)
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if e is not removed))

    def unnamed(self) -> Scene:
        """The scene without metadata (name, side, measurements, limits, bones): equal models share one program."""
        return dataclasses.replace(self, name="", synthetic=False, measured=None, limits=None, bones=None, left=False)

    def with_limits(self, **limits: float) -> Scene:
        """The scene with limits for a knee, which `check` enforces. Keywords override the default limits.

        Raises:
            InputError: there is no such limit in `pftwin.model.limits.Limits`, or its value is not a number.
        """
        return dataclasses.replace(self, limits=Limits.of(limits))

    @property
    def contact(self) -> Contact | None:
        """The contact between button and femur that results report, of any geometry; None if there is none."""
        return next((role for e in self.effects if (role := e.contact_role()) is not None), None)

    @property
    def surface(self) -> Surface | None:
        """Surface of the contact or its smooth substitute (see `Contact.groove_surface`); None if there is none."""
        return None if self.contact is None else self.contact.groove_surface()

    def tracked_point(self) -> Vec3:
        """Point whose path results show, patella frame [m]: the button's centre or, without contact, the origin."""
        return Vec3.zero() if self.contact is None else self.contact.tracked_point()

    def get(self, name: str) -> Any:
        """A parameter by name (number, array or `Vec3`, SI units): "K1", "quadriceps.origin", "patella.mass".

        Raises:
            InputError: there is no such parameter; the message suggests the closest name.
        """
        return get_value(self, name)

    def set(self, name: str, value: Any) -> Scene:
        """The scene with the parameter `name` set to `value` in SI units. The value has the field's shape; for a vector
        such as "quadriceps.origin" it is a `Vec3` or an array (..., 3). Supports jit, vmap and differentiation.

        Raises:
            InputError: there is no such parameter, or the value has another shape.
        """
        return with_value(self, name, value)

    def center_of_mass_pose(self) -> Pose:
        """Start pose of a frame at the centre of mass, with the patella's axes."""
        return Pose(self.start.apply(self.patella.center_of_mass), self.start.orientation)


def check(scene: Scene) -> None:
    """Validates the parameters of a scene on the host, before tracing.

    Raises:
        InputError: a parameter is not finite or outside its declared bounds (the message gives its path), two effects
            have the same name, or a scene with limits exceeds one.
    """
    names = [e.name for e in scene.effects]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two effects are named {name!r}", where=scene.name, remedy="give them different names")
    leaves, structure = jax.tree.flatten(scene)
    values = [np.ones(0) if isinstance(a, Tracer) else np.asarray(a, dtype=float).ravel() for a in leaves]
    # Checks all values at once, since this runs before every simulation; `_refuse` then finds the wrong parameter.
    fine = bool(np.isfinite(np.concatenate([*values, np.ones(1)])).all())
    for declared, which in bounded_leaves(structure):
        fine = fine and declared.offender(np.concatenate([values[i] for i in which])) is None
    if not fine:
        _refuse(scene)
    if scene.limits is not None and not any(isinstance(leaf, Tracer) for leaf in leaves):
        check_limits(scene, scene.limits)


def _refuse(scene: Scene) -> None:
    """Raises an error that names the first invalid parameter."""
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
