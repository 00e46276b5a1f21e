"""References to numbers in a scene, through which they are read and written."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pftwin.base.quantities import Quantity, declarations
from pftwin.base.spatial import Scalar
from pftwin.model.effects.base import Ground, Instant, Patella

if TYPE_CHECKING:
    from pftwin.model.effects.line_elements import LineElement
    from pftwin.model.scene import Scene

UNITS = {"strain": "", "force": "N"}  # ways to express a slack length
TIED = "~"  # separates the names of tied numbers
TOGETHER = "[:]"  # suffix of a field whose numbers all change together
_OWN = ("patella", "start", "motion")  # parts of a scene that are not effects


class NumberPlace(NamedTuple):
    """Reference to a number in a scene, or to all numbers of a field: as an array, or `together`, as their mean.

    `meaning` is "value" for the number itself. The slack length L0 of a line element may also be expressed as a
    "strain" (L - L0) / L0, or as a "force", the static tension at the length L, where L is the length of the line at
    the scene's start pose in the first frame.

    Numbers that are `tied` to it, or `together`, change with it: in proportion to their values in the scene or, for
    coordinates, by the same offset.
    """

    owner: str  # name of an effect, or "patella", "start" or "motion"
    path: tuple[str, ...]
    index: int | None
    meaning: str
    tied: tuple[NumberPlace, ...] = ()
    together: bool = False

    @property
    def name(self) -> str:
        """The name, as users write it."""
        return TIED.join(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Its name, followed by those of the numbers tied to it."""
        index = TOGETHER if self.together else "" if self.index is None else f"[{self.index}]"
        ending = "" if self.meaning == "value" else f".{self.meaning}"
        return (".".join([self.owner, *self.path]) + index + ending, *(name for t in self.tied for name in t.names))

    @property
    def numbers(self) -> frozenset[tuple[str, tuple[str, ...], int | None]]:
        """Keys (owner, path, index) of the scene's numbers that it changes, whatever its meaning."""
        return frozenset({(self.owner, self.path, self.index)}.union(*(t.numbers for t in self.tied)))

    def overlaps(self, other: NumberPlace) -> bool:
        """Whether both change the same number of a scene."""
        pairs = itertools.product(self.numbers, other.numbers)
        return any(a[:2] == b[:2] and (a[2] == b[2] or None in (a[2], b[2])) for a, b in pairs)

    def proportions(self, scene: Scene) -> list[float]:
        """Values of the numbers that change with it in a scene, divided by its own value."""
        own = float(self.read(scene))
        together = np.ravel(follow(owner_of(scene, self.owner), self.path)).tolist() if self.together else []
        return [value / own for value in (*together, *(float(t.read(scene)) for t in self.tied))]

    def unit(self, scene: Scene) -> str:
        """Its unit; empty if dimensionless."""
        if self.meaning != "value":
            return UNITS[self.meaning]
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return "" if declared is None else declared.unit

    def is_coordinate(self, scene: Scene) -> bool:
        """Whether it is a coordinate of a point such as an attachment, so that scaling it would be meaningless."""
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return declared is not None and declared.frame != "" and declared.unit == "m"

    def read(self, scene: Scene) -> Scalar:
        """Its value in a scene (SI units)."""
        owner = owner_of(scene, self.owner)
        value = follow(owner, self.path)
        if self.together:
            return jnp.mean(value)
        value = value if self.index is None else jnp.asarray(value)[self.index]
        if self.meaning == "value":
            return jnp.asarray(value)
        length = start_length(scene, owner)
        return (length - value) / value if self.meaning == "strain" else owner.held_tension(length)

    def written(self, scene: Scene, value: Scalar) -> Scene:
        """The scene with the number, and those that change with it, set from `value`; does not modify `scene`."""
        if self.tied:
            own, moved = self.read(scene), self.is_coordinate(scene)
            for other in self.tied:
                old = other.read(scene)
                scene = other.written(scene, old + (value - own) if moved else old * (value / own))
        owner = owner_of(scene, self.owner)
        if self.meaning == "strain":
            value = start_length(scene, owner) / (1 + value)
        elif self.meaning == "force":
            value = owner.slack_length_for(start_length(scene, owner), value)
        old = jnp.asarray(follow(owner, self.path))
        if self.together:
            own = jnp.mean(old)
            value = old + (value - own) if self.is_coordinate(scene) else old * (value / own)
        new = jnp.asarray(value, old.dtype) if self.index is None else old.at[self.index].set(value)
        return replaced(scene, self.owner, self.path, new)


class Field(NamedTuple):
    """Location, shape and declaration of an array in a scene."""

    owner: str
    path: tuple[str, ...]
    shape: tuple[int, ...]
    quantity: Quantity | None  # its declared unit and bounds


def named_arrays(scene: Scene) -> dict[str, Field]:
    """All numeric arrays of a scene, by name."""
    out = {}
    for owner, value in (*((n, getattr(scene, n)) for n in _OWN), *((e.name, e) for e in scene.effects)):
        for path, leaf, quantity in declarations(value):
            if np.shape(leaf) or eqx.is_array(leaf):
                out[".".join([owner, *path])] = Field(owner, path, np.shape(leaf), quantity)
    return out


def start_length(scene: Scene, element: LineElement) -> Scalar:
    """Length of a line element at the scene's start pose in the first frame [m], one per line of a group."""
    return element.line(starting_instant(scene)).length


def starting_instant(scene: Scene) -> Instant:
    """The instant of the first frame with the patella at rest in the scene's start pose."""
    start = jnp.asarray(scene.motion.start_time, dtype=float)
    femur, tibia = scene.motion.frames(start)
    patella = Patella.at_rest(scene.start.position, scene.start.orientation)
    return Instant(patella, Ground() if femur is None else femur, tibia, start, 0.0)


def owner_of(scene: Scene, name: str) -> Any:
    """The effect named `name`, else the scene's field of that name."""
    effect = next((e for e in scene.effects if e.name == name), None)
    return getattr(scene, name) if effect is None else effect


def replaced(scene: Scene, owner: str, path: tuple[str, ...], value: Any) -> Scene:
    """The scene with `value` at `path` inside the effect or field `owner`."""
    old = owner_of(scene, owner)
    changed = eqx.tree_at(lambda o: follow(o, path), old, value)
    if any(e is old for e in scene.effects):
        return scene.with_effect(changed)
    return eqx.tree_at(lambda s: getattr(s, owner), scene, changed)


def follow(value: Any, path: tuple[str, ...]) -> Any:
    """The object at `path` inside `value`: a sequence of field names and tuple indices."""
    for part in path:
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return value
