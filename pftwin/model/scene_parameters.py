"""Access to the numbers of a scene by readable names: "K1", "quadriceps.slack_length", "patella.mass"."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from pftwin.base.errors import InputError
from pftwin.base.quantities import Quantity, declarations
from pftwin.base.spatial import Scalar, Vec3

if TYPE_CHECKING:
    from pftwin.model.effects.base import Effect
    from pftwin.model.effects.line_elements import ElasticLine, LineElement
    from pftwin.model.scene import Scene

_SHORT = re.compile(r"^([A-Z])(\d+)(?:\.(strain|force))?$")
_INDEXED = re.compile(r"^(.*)\[(\d+)\]$")
_UNITS = {"strain": "", "force": "N"}  # ways to express a slack length
_OWN = ("patella", "start", "motion")  # parts of a scene that are no effects
_TIED = "~"  # between numbers that go together


class NumberPlace(NamedTuple):
    """A number in a scene, or all numbers of one field.

    `meaning` is "value" for the number itself. The slack length L0 of a line element may be expressed otherwise,
    with L its length at the scene's start pose in the first frame: "strain" is (L - L0) / L0, "force" the tension of
    the line when held at that length.

    What is `tied` goes with it: in proportion to what the scene has, or, of coordinates, by the same offset.
    """

    owner: str  # name of an effect; "patella", "start" or "motion" for the scene's own parts
    path: tuple[str, ...]
    index: int | None
    meaning: str
    tied: tuple[NumberPlace, ...] = ()

    @property
    def name(self) -> str:
        """The name as a user may write it."""
        return _TIED.join(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Its own name, and those of what is tied to it."""
        index = "" if self.index is None else f"[{self.index}]"
        ending = "" if self.meaning == "value" else f".{self.meaning}"
        return (".".join([self.owner, *self.path]) + index + ending, *(name for t in self.tied for name in t.names))

    @property
    def numbers(self) -> frozenset[tuple[str, tuple[str, ...], int | None]]:
        """The scene's numbers that it changes, whatever they mean."""
        return frozenset({(self.owner, self.path, self.index)}.union(*(t.numbers for t in self.tied)))

    def unit(self, scene: Scene) -> str:
        """Its unit; empty for a pure number."""
        if self.meaning != "value":
            return _UNITS[self.meaning]
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return "" if declared is None else declared.unit

    def is_coordinate(self, scene: Scene) -> bool:
        """Whether it is a coordinate of a point, such as an attachment, and so no quantity with a size of its own."""
        declared = named_arrays(scene)[".".join([self.owner, *self.path])].quantity
        return declared is not None and declared.frame != "" and declared.unit == "m"

    def read(self, scene: Scene) -> Scalar:
        """The value in a scene."""
        owner = _owner(scene, self.owner)
        value = _follow(owner, self.path)
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
        owner = _owner(scene, self.owner)
        if self.meaning == "strain":
            value = start_length(scene, owner) / (1 + value)
        elif self.meaning == "force":
            value = owner.slack_length_for(start_length(scene, owner), value)
        old = jnp.asarray(_follow(owner, self.path))
        new = jnp.asarray(value, old.dtype) if self.index is None else old.at[self.index].set(value)
        return _replaced(scene, self.owner, self.path, new)


class Field(NamedTuple):
    """An array of numbers in a scene."""

    owner: str
    path: tuple[str, ...]
    shape: tuple[int, ...]
    quantity: Quantity | None  # its declaration


def start_length(scene: Scene, element: LineElement) -> Scalar:
    """A line element's length at the scene's start pose in the first frame [m]; one for each line of a group."""
    insertion, body = element.line_ends
    start = jnp.asarray(scene.motion.start_time, dtype=float)
    femur, tibia = scene.motion.frames(start)
    frame = {"tibia": tibia, "femur": femur}.get(body)
    origin = element.origin_at(start)
    origin = origin if frame is None else frame.point(origin)
    return (origin - scene.start.apply(insertion)).norm()


def find(scene: Scene, name: str) -> list[NumberPlace]:
    """The places that a name stands for: one, or those of a whole vector.

    "K1", "L1", "K2" ... are what the scene's elastic line elements (tendons, strands), in their order, declare with
    these letters: stiffness and slack length. Otherwise "effect.field.field", "patella.field", with an index for an
    element ("contact.surface.coefficients[3]"). "L1.strain" and "L1.force": see `NumberPlace`. Names with "~" between
    them are of numbers that are tied ("quadriceps.damping~patellar_tendon.damping"): the first is told.

    Raises:
        InputError: no such number in this scene, with the nearest name that there is; a tie of unlike numbers.
    """
    if _TIED in name:
        return [_tie(scene, name)]
    full, meaning = _long_name(scene, name)
    index = None
    if match := _INDEXED.match(full):
        full, index = match.group(1), int(match.group(2))
    numbers = named_arrays(scene)
    if full not in numbers:
        raise _unknown(scene, name)
    owner, path, shape, _ = numbers[full]
    if meaning != "value":
        elastic = any(e.name == owner for e in numbered_elements(scene))
        if not elastic or shape != () or path != ("slack_length",):
            raise InputError(f"{name!r}: only the slack length of a single tendon has a {meaning}", where="free")
    if index is None and not shape:
        return [NumberPlace(owner, path, None, meaning)]
    if len(shape) != 1 or (index is not None and index >= shape[0]):
        raise InputError(
            f"{name!r} in scene {scene.name!r}, which has {shape[0] if shape else 'a single number'} there",
            where="free",
            expected=full if not shape else f"{full}[0] to {full}[{shape[0] - 1}], or {full} for all of them",
        )
    return [NumberPlace(owner, path, i, meaning) for i in (range(shape[0]) if index is None else [index])]


def _tie(scene: Scene, name: str) -> NumberPlace:
    """The place of the first of several numbers, with the others tied to it."""
    places = [place for part in name.split(_TIED) for place in find(scene, part.strip())]
    if len(places) != name.count(_TIED) + 1 or any(p.meaning != "value" for p in places):
        raise InputError(f"{name!r}: a vector, or a strain or force", where="free", expected="single numbers")
    if len({p.name for p in places}) < len(places):
        raise InputError(f"{name!r} ties a number to itself", where="free", expected="different numbers")
    if len({(p.unit(scene), p.is_coordinate(scene)) for p in places}) > 1:
        units = ", ".join(p.unit(scene) or "a pure number" for p in places)
        raise InputError(f"{name!r} ties unlike numbers: {units}", where="free", expected="numbers of one unit")
    if not places[0].is_coordinate(scene):
        values = [p.read(scene) for p in places]
        if any(not isinstance(v, Tracer) and np.any(np.asarray(v) == 0) for v in values):
            raise InputError(f"{name!r}: one of them is 0", where="free", expected="numbers that have a proportion")
    return places[0]._replace(tied=tuple(places[1:]))


def named_arrays(scene: Scene) -> dict[str, Field]:
    """Every array of numbers in a scene, by name."""
    out = {}
    for owner, value in (*((n, getattr(scene, n)) for n in _OWN), *((e.name, e) for e in scene.effects)):
        for path, leaf, quantity in declarations(value):
            if np.shape(leaf) or eqx.is_array(leaf):
                out[".".join([owner, *path])] = Field(owner, path, np.shape(leaf), quantity)
    return out


def get_value(scene: Scene, name: str) -> Any:
    """The value under a name in a scene: an array, or a `Vec3` of arrays.

    Raises:
        InputError: no such number.
    """
    if (vector := _vector(scene, name)) is not None:
        return _follow(_owner(scene, vector[0]), vector[1])
    return _one_place(scene, name).read(scene)


def with_value(scene: Scene, name: str, value: Any) -> Scene:
    """The scene with another value under a name. Pure: the value, and any leaf of the scene, may be traced.

    Args:
        scene: that has such a number.
        name: as `find` knows it, or that of a vector ("quadriceps.origin").
        value: of the field's shape; of a vector a `Vec3` or an array (..., 3); SI units.

    Raises:
        InputError: no such number; a value of another shape.
    """
    if (vector := _vector(scene, name)) is not None:
        owner, path = vector
        old = _follow(_owner(scene, owner), path)
        if not isinstance(value, Vec3) and np.shape(value)[-1:] != (3,):
            raise InputError(
                f"found shape {np.shape(value)}", where=name, expected="three components along the last axis"
            )
        new = value if isinstance(value, Vec3) else Vec3.from_array(value)
        shapes = [np.shape(a) for v in (old, new) for a in (v.x, v.y, v.z)]
        if shapes[:3] != shapes[3:]:
            raise InputError(f"found shape {shapes[3]}", where=name, expected=f"components of shape {shapes[0]}")
        return _replaced(scene, owner, path, new)
    place = _one_place(scene, name)
    shape = np.shape(_follow(_owner(scene, place.owner), place.path)) if place.index is None else ()
    if np.shape(value) != shape:
        raise InputError(f"found shape {np.shape(value)}", where=name, expected=f"shape {shape}")
    return place.written(scene, value)


def _one_place(scene: Scene, name: str) -> NumberPlace:
    """The place of a name, that of a whole field included."""
    full, _ = _long_name(scene, name)
    if full in (numbers := named_arrays(scene)) and numbers[full].shape:
        return NumberPlace(numbers[full].owner, numbers[full].path, None, "value")
    return find(scene, name)[0]


def _vector(scene: Scene, name: str) -> tuple[str, tuple[str, ...]] | None:
    """Owner and path of a vector of three fields x, y, z."""
    found = named_arrays(scene).get(f"{name}.x")
    return None if found is None else (found.owner, found.path[:-1])


def numbered_elements(scene: Scene) -> list[ElasticLine]:
    """The scene's elastic line elements in their order: the first is that of K1 and L1."""
    lines = (e.line_element() for e in scene.effects)
    return [line for line in lines if line is not None and line.elastic]  # type: ignore[misc]


def _long_name(scene: Scene, name: str) -> tuple[str, str]:
    """A name with short names written out, and its meaning."""
    match = _SHORT.match(name)
    if match is None:
        for meaning in _UNITS:
            if name.endswith(f".slack_length.{meaning}"):
                return name.removesuffix(f".{meaning}"), meaning
        return name, "value"
    letter, number, meaning = match.groups()
    elements = numbered_elements(scene)
    letters = {letter for e in elements for letter in _aliases(e)}
    if letter not in letters or (meaning and letter != "L"):
        raise _unknown(scene, name)
    if not 1 <= int(number) <= len(elements):
        raise InputError(
            f"no parameter {name!r}: scene {scene.name!r} has {len(elements)} tendon(s)",
            where="free",
            expected=", ".join(f"{k}{i + 1}" for i in range(len(elements)) for k in sorted(letters)),
        )
    element = elements[int(number) - 1]
    full = f"{element.name}.{_aliases(element)[letter]}"
    if element.count is not None:
        raise InputError(
            f"{name!r} is that of {element.name!r}, a group of {element.count}",
            where="free",
            expected=f"{full}[0] to {full}[{element.count - 1}], or {full} for all of them",
        )
    return full, meaning or "value"


def _aliases(effect: Effect) -> dict[str, str]:
    """Fields of an effect by their letters."""
    return {q.alias: field for field, q in effect.quantities().items() if q.alias}


def _owner(scene: Scene, name: str) -> Any:
    """The effect of that name, else the scene's own part."""
    effect = next((e for e in scene.effects if e.name == name), None)
    return getattr(scene, name) if effect is None else effect


def _replaced(scene: Scene, owner: str, path: tuple[str, ...], value: Any) -> Scene:
    """The scene with another value at a path below an effect or a part of its own."""
    old = _owner(scene, owner)
    changed = eqx.tree_at(lambda o: _follow(o, path), old, value)
    if any(e is old for e in scene.effects):
        return scene.with_effect(changed)
    return eqx.tree_at(lambda s: getattr(s, owner), scene, changed)


def _follow(value: Any, path: tuple[str, ...]) -> Any:
    for part in path:
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return value


def _unknown(scene: Scene, name: str) -> InputError:
    names = [n for n, f in named_arrays(scene).items() if f.owner != "motion"]
    elements = numbered_elements(scene)
    short = [f"{k}{i + 1}" for i, e in enumerate(elements) if e.count is None for k in _aliases(e)]
    near = difflib.get_close_matches(name, [*names, *short], 1, cutoff=0.0)
    return InputError(
        f"no parameter {name!r} in scene {scene.name!r}",
        where="free",
        expected=f"such as {near[0]!r}" if near else None,
        remedy=f"one of: {', '.join([*short, *names][:12])} ...",
    )
