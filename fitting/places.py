"""Where a parameter lives in a scene, and how a name that a person writes finds it."""

from __future__ import annotations

import difflib
import re
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.trajectory import first_guide
from pftwin.effects.tendon import Tendon
from pftwin.errors import InputError
from pftwin.scene import Scene
from pftwin.spatial import Scalar

_SPRING = re.compile(r"^([KL])(\d+)(?:\.(strain|force))?$")
_INDEXED = re.compile(r"^(.*)\[(\d+)\]$")
_UNITS = {
    "stiffness": "N/m",
    "slack_length": "m",
    "damping": "N s/m",
    "radius": "m",
    "coefficients": "m",
    "mass": "kg",
    "contact_stiffness": "N/m^p",
    "strain": "",
    "force": "N",
    "toe_strain": "",
    "damping_time": "s",
    "restitution": "",
    "translational": "N s/m",
    "rotational": "N m s/rad",
}


class Place(NamedTuple):
    """A number in a scene.

    `meaning` is "value" for the number itself. A tendon's slack length L0 may stand there as something else, with L
    its length at the scene's start pose in the first frame: "strain" is (L - L0) / L0, "force" is K (L - L0).
    """

    effect: str  # name of an effect; "" for the patella's body
    path: tuple[str, ...]
    index: int | None
    meaning: str

    @property
    def name(self) -> str:
        """As it may be written."""
        index = "" if self.index is None else f"[{self.index}]"
        ending = "" if self.meaning == "value" else f".{self.meaning}"
        return ".".join([self.effect or "patella", *self.path]) + index + ending

    @property
    def unit(self) -> str:
        """Its unit; empty for a pure number."""
        last = self.path[-1] if self.meaning == "value" else self.meaning
        if last in ("x", "y", "z"):
            return "kg m^2" if self.path[0] == "inertia" else "m"
        return _UNITS.get(last, "")

    def read(self, scene: Scene) -> Scalar:
        """The value in a scene."""
        owner = _owner(scene, self.effect)
        value = _follow(owner, self.path)
        value = value if self.index is None else jnp.asarray(value)[self.index]
        if self.meaning == "value":
            return jnp.asarray(value)
        stretch = start_length(scene, owner) - value
        return stretch / value if self.meaning == "strain" else owner.stiffness * stretch

    def written(self, scene: Scene, value: Scalar) -> Scene:
        """The scene with this value there. Pure."""
        owner = _owner(scene, self.effect)
        if self.meaning == "strain":
            value = start_length(scene, owner) / (1 + value)
        elif self.meaning == "force":
            value = start_length(scene, owner) - value / owner.stiffness
        old = jnp.asarray(_follow(owner, self.path))
        new = jnp.asarray(value, old.dtype) if self.index is None else old.at[self.index].set(value)
        changed = eqx.tree_at(lambda o: _follow(o, self.path), owner, new)
        if self.effect:
            return scene.with_effect(changed)
        return eqx.tree_at(lambda s: s.patella, scene, changed)


def start_length(scene: Scene, tendon: Tendon) -> Scalar:
    """A tendon's length at the scene's start pose in the first frame [m]."""
    guide = first_guide(scene)
    frame = {"tibia": guide.tibia, "femur": guide.femur}.get(tendon.body)
    origin = tendon.origin if frame is None else frame.point(tendon.origin)
    return (origin - scene.start.apply(tendon.insertion)).norm()


def find(scene: Scene, name: str) -> list[Place]:
    """The places that a name stands for: one, or those of a whole vector.

    "K1", "L1", "K2" ... are stiffness and slack length of the scene's tendons in their order; otherwise
    "effect.field.field", "patella.field", with an index for an element ("contact.surface.coefficients[3]").

    Raises:
        InputError: no such number in this scene, with the nearest name that there is.
    """
    written = name
    if match := _SPRING.match(name):
        kind, number, meaning = match.groups()
        tendons = [e.name for e in scene.effects if isinstance(e, Tendon)]
        if kind == "K" and meaning:
            raise _unknown(scene, written)
        if not 1 <= int(number) <= len(tendons):
            raise InputError(
                f"no parameter {written!r}: scene {scene.name!r} has {len(tendons)} tendon(s)",
                where="free",
                expected=", ".join(f"K{i + 1}, L{i + 1}" for i in range(len(tendons))) or "a scene with a Tendon",
            )
        field = "stiffness" if kind == "K" else "slack_length"
        name = ".".join([tendons[int(number) - 1], field, *([meaning] if meaning else [])])
    meaning, index = "value", None
    if name.endswith((".slack_length.strain", ".slack_length.force")):
        name, _, meaning = name.rpartition(".")
    if match := _INDEXED.match(name):
        name, index = match.group(1), int(match.group(2))
    numbers = known(scene)
    if name not in numbers:
        raise _unknown(scene, written)
    owner, path, shape = numbers[name]
    if meaning != "value" and not (isinstance(_owner(scene, owner), Tendon) and shape == ()):
        raise InputError(f"{written!r}: only the slack length of a single Tendon has a {meaning}", where="free")
    if index is None and not shape:
        return [Place(owner, path, None, meaning)]
    if len(shape) != 1 or (index is not None and index >= shape[0]):
        raise InputError(
            f"{written!r} in scene {scene.name!r}, which has {shape[0] if shape else 'a single number'} there",
            where="free",
            expected=name if not shape else f"{name}[0] to {name}[{shape[0] - 1}], or {name} for all of them",
        )
    return [Place(owner, path, i, meaning) for i in (range(shape[0]) if index is None else [index])]


def known(scene: Scene) -> dict[str, tuple[str, tuple[str, ...], tuple[int, ...]]]:
    """Every array of numbers that can be free, by name: effect, path and shape."""
    out = {}
    for effect, owner in (("", scene.patella), *((e.name, e) for e in scene.effects)):
        for keys, leaf in jax.tree_util.tree_leaves_with_path(owner):
            path = tuple(getattr(k, "name", None) or f"{getattr(k, 'idx', k)}" for k in keys)
            if np.shape(leaf) or eqx.is_array(leaf):
                out[".".join([effect or "patella", *path])] = (effect, path, np.shape(leaf))
    return out


def _owner(scene: Scene, effect: str) -> Any:
    return scene.effect(effect) if effect else scene.patella


def _follow(value: Any, path: tuple[str, ...]) -> Any:
    for part in path:
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return value


def _unknown(scene: Scene, name: str) -> InputError:
    names = list(known(scene))
    tendons = [e.name for e in scene.effects if isinstance(e, Tendon)]
    short = [f"{k}{i + 1}" for i in range(len(tendons)) for k in "KL"]
    near = difflib.get_close_matches(name, [*names, *short], 1, cutoff=0.0)
    return InputError(
        f"no parameter {name!r} in scene {scene.name!r}",
        where="free",
        expected=f"such as {near[0]!r}" if near else None,
        remedy=f"one of: {', '.join([*short, *names][:12])} ...",
    )
