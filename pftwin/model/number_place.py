"""Where a number is in a scene, and how it is read and written."""

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
TIED = "~"  # between numbers that go together
TOGETHER = "[:]"  # behind a field of which all numbers go together
_OWN = ("patella", "start", "motion")  # parts of a scene that are no effects


class NumberPlace(NamedTuple):
    """A number in a scene, or all numbers of one field: as they are, or `together`, as one number that is their mean.

    `meaning` is "value" for the number itself. The slack length L0 of a line element may be expressed otherwise,
    with L its length at the scene's start pose in the first frame: "strain" is (L - L0) / L0, "force" the tension of
    the line when held at that length.

    What is `tied`, or `together`, goes with it: in proportion to what the scene has, or, of coordinates, by the same
    offset.
    """

    owner: str  # name of an effect; "patella", "start" or "motion" for the scene's own parts
    path: tuple[str, ...]
    index: int | None
    meaning: str
    tied: tuple[NumberPlace, ...] = ()
    together: bool = False

    @property
    def name(self) -> str:
        """The name as a user may write it."""
        return TIED.join(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Its own name, and those of what is tied to it."""
        index = TOGETHER if self.together else "" if self.index is None else f"[{self.index}]"
        ending = "" if self.meaning == "value" else f".{self.meaning}"
        return (".".join([self.owner, *self.path]) + index + ending, *(name for t in self.tied for name in t.names))

    @property
    def numbers(self) -> frozenset[tuple[str, tuple[str, ...], int | None]]:
        """The scene's numbers that it changes, whatever they mean."""
        return frozenset({(self.owner, self.path, self.index)}.union(*(t.numbers for t in self.tied)))

    def overlaps(self, other: NumberPlace) -> bool:
        """Whether both change one and the same number."""
        pairs = itertools.product(self.numbers, other.numbers)
        return any(a[:2] == b[:2] and (a[2] == b[2] or None in (a[2], b[2])) for a, b in pairs)

    def proportions(self, scene: Scene) -> list[float]:
        """What goes with it in a scene, as shares of itself."""
        own = float(self.read(scene))
        together = np.ravel(follow(owner_of(scene, self.owner), self.path)).tolist() if self.together else []
        return [value / own for value in (*together, *(float(t.read(scene)) for t in self.tied))]

    def unit(self, scene: Scene) -> str:
        """Its unit; empty for a pure number."""
        if self.meaning != "value":
            return UNITS[self.meaning]
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return "" if declared is None else declared.unit

    def is_coordinate(self, scene: Scene) -> bool:
        """Whether it is a coordinate of a point, such as an attachment, and so no quantity with a size of its own."""
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return declared is not None and declared.frame != "" and declared.unit == "m"

    def read(self, scene: Scene) -> Scalar:
        """The value in a scene."""
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
        """The scene with this value there. Pure."""
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
    """An array of numbers in a scene."""

    owner: str
    path: tuple[str, ...]
    shape: tuple[int, ...]
    quantity: Quantity | None  # its declaration


def named_arrays(scene: Scene) -> dict[str, Field]:
    """Every array of numbers in a scene, by name."""
    out = {}
    for owner, value in (*((n, getattr(scene, n)) for n in _OWN), *((e.name, e) for e in scene.effects)):
        for path, leaf, quantity in declarations(value):
            if np.shape(leaf) or eqx.is_array(leaf):
                out[".".join([owner, *path])] = Field(owner, path, np.shape(leaf), quantity)
    return out


def start_length(scene: Scene, element: LineElement) -> Scalar:
    """A line element's length at the scene's start pose in the first frame [m]; one for each line of a group."""
    return element.line(starting_instant(scene)).length


def starting_instant(scene: Scene) -> Instant:
    """The scene at its start pose in the first frame, at rest."""
    start = jnp.asarray(scene.motion.start_time, dtype=float)
    femur, tibia = scene.motion.frames(start)
    patella = Patella.at_rest(scene.start.position, scene.start.orientation)
    return Instant(patella, Ground() if femur is None else femur, tibia, start, 0.0)


def owner_of(scene: Scene, name: str) -> Any:
    """The effect of that name, else the scene's own part."""
    effect = next((e for e in scene.effects if e.name == name), None)
    return getattr(scene, name) if effect is None else effect


def replaced(scene: Scene, owner: str, path: tuple[str, ...], value: Any) -> Scene:
    """The scene with another value at a path below an effect or a part of its own."""
    old = owner_of(scene, owner)
    changed = eqx.tree_at(lambda o: follow(o, path), old, value)
    if any(e is old for e in scene.effects):
        return scene.with_effect(changed)
    return eqx.tree_at(lambda s: getattr(s, owner), scene, changed)


def follow(value: Any, path: tuple[str, ...]) -> Any:
    """What lies at a path below something: names of fields, and indices of tuples."""
    for part in path:
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return value
