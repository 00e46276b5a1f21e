"""Access to the parameters of a scene by name: "K1", "quadriceps.slack_length", "patella.mass"."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.core import Tracer

from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.model.limits import not_pulled
from pftwin.model.number_place import TIED, TOGETHER, UNITS, NumberPlace, follow, named_arrays, owner_of, replaced

if TYPE_CHECKING:
    from pftwin.model.effects.base import Effect
    from pftwin.model.effects.line_elements import ElasticLine
    from pftwin.model.scene import Scene

_SHORT = re.compile(r"^([A-Z])(\d+)(?:\.(strain|force))?$")
_INDEXED = re.compile(r"^(.*)\[(\d+)\]$")


def find(scene: Scene, name: str, where: str = "free") -> list[NumberPlace]:
    """Resolves a parameter name to the numbers it denotes: one, or one for each element of an array.

    - "K1", "L1", "K2", ...: stiffness or slack length of the elastic line elements (tendons, strands), in their order.
    - "L1.strain", "L1.force": the slack length as a strain or a tension; see `NumberPlace`.
    - "effect.field.field", "patella.field", "contact.surface.coefficients[3]": a field, or one of its elements.
    - "pt.slack_length[:]": all elements of a field, scaled together (coordinates: shifted), given by their mean.
    - "quadriceps.damping~patellar_tendon.damping": numbers tied to the first, which gives the value.

    Raises:
        InputError: there is no such parameter (the message suggests the closest name), or tied numbers are unlike;
            the message begins with `where`, the argument or function that was given the name.
    """
    with _asked_by(where):
        return _places(scene, name)


@contextmanager
def _asked_by(where: str) -> Iterator[None]:
    """Puts what was called before messages that do not yet say where."""
    try:
        yield
    except InputError as error:
        if error.where is not None:
            raise
        raise InputError(error.problem, where=where, expected=error.expected, remedy=error.remedy) from None


def _places(scene: Scene, name: str) -> list[NumberPlace]:
    """See `find`."""
    if TIED in name:
        return [_tie(scene, name)]
    full, meaning = _long_name(scene, name)
    if full.endswith(TOGETHER):
        return [_together(scene, name, full.removesuffix(TOGETHER))]
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
            raise InputError(f"{name!r}: only the slack length of a single tendon has a {meaning}")
    if index is None and not shape:
        return [NumberPlace(owner, path, None, meaning)]
    if len(shape) != 1 or (index is not None and index >= shape[0]):
        raise InputError(
            f"{name!r} in scene {scene.name!r}, which has {shape[0] if shape else 'a single number'} there",
            expected=_expected(full, shape),
        )
    return [NumberPlace(owner, path, i, meaning) for i in (range(shape[0]) if index is None else [index])]


def _together(scene: Scene, name: str, field: str) -> NumberPlace:
    """Resolves "FIELD[:]", all elements of a field together."""
    numbers = named_arrays(scene)
    if field not in numbers:
        raise _unknown(scene, name)
    owner, path, shape, _ = numbers[field]
    if not shape:
        raise InputError(f"{name!r} is a single number", expected=field)
    place = NumberPlace(owner, path, None, "value", together=True)
    mean = place.read(scene)
    if not place.is_coordinate(scene) and not isinstance(mean, Tracer) and float(mean) == 0:
        raise InputError(f"{name!r}: their mean is 0", expected="a mean other than 0")
    return place


def _tie(scene: Scene, name: str) -> NumberPlace:
    """Resolves "A~B~...": the place of the first number, with the others tied to it."""
    places = [place for part in name.split(TIED) for place in _places(scene, part.strip())]
    if len(places) != name.count(TIED) + 1 or any(p.meaning != "value" for p in places):
        raise InputError(f"{name!r}: a vector, or a strain or force", expected="single numbers")
    if any(a.overlaps(b) for a, b in itertools.combinations(places, 2)):
        raise InputError(f"{name!r} ties a number to itself", expected="different numbers")
    if len({(p.unit(scene), p.is_coordinate(scene)) for p in places}) > 1:
        units = ", ".join(p.unit(scene) or "a pure number" for p in places)
        raise InputError(f"{name!r} ties unlike numbers: {units}", expected="numbers of one unit")
    if not places[0].is_coordinate(scene):
        values = [p.read(scene) for p in places]
        if any(not isinstance(v, Tracer) and np.any(np.asarray(v) == 0) for v in values):
            raise InputError(f"{name!r}: one of them is 0", expected="numbers other than 0")
    return places[0]._replace(tied=tuple(places[1:]))


def _expected(full: str, shape: tuple[int, ...]) -> str:
    """Names that denote the elements of a field, for error messages."""
    together = f"{full}{TOGETHER} for all together"
    if len(shape) == 1:
        return f"{full}[0] to {full}[{shape[0] - 1}], {full} for each of them, or {together}"
    return together if shape else full


def get_value(scene: Scene, name: str) -> Any:
    """See `Scene.get`."""
    if (vector := _vector(scene, name)) is not None:
        return follow(owner_of(scene, vector[0]), vector[1])
    with _asked_by("scene.get"):
        return _one_place(scene, name).read(scene)


def with_value(scene: Scene, name: str, value: Any) -> Scene:
    """See `Scene.set`."""
    if (vector := _vector(scene, name)) is not None:
        owner, path = vector
        old = follow(owner_of(scene, owner), path)
        if not isinstance(value, Vec3) and np.shape(value)[-1:] != (3,):
            raise InputError(
                f"found shape {np.shape(value)}", where=name, expected="three components along the last axis"
            )
        new = value if isinstance(value, Vec3) else Vec3.from_array(value)
        shapes = [np.shape(a) for v in (old, new) for a in (v.x, v.y, v.z)]
        if shapes[:3] != shapes[3:]:
            raise InputError(f"found shape {shapes[3]}", where=name, expected=f"components of shape {shapes[0]}")
        return replaced(scene, owner, path, new)
    with _asked_by("scene.set"):
        place = _one_place(scene, name)
    whole = place.index is None and not place.together
    shape = np.shape(follow(owner_of(scene, place.owner), place.path)) if whole else ()
    if np.shape(value) != shape:
        raise InputError(f"found shape {np.shape(value)}", where=name, expected=f"shape {shape}")
    return place.written(scene, value)


def _one_place(scene: Scene, name: str) -> NumberPlace:
    """The place that a name denotes, which may be a whole array."""
    full, _ = _long_name(scene, name)
    if full in (numbers := named_arrays(scene)) and numbers[full].shape:
        return NumberPlace(numbers[full].owner, numbers[full].path, None, "value")
    return _places(scene, name)[0]


def _vector(scene: Scene, name: str) -> tuple[str, tuple[str, ...]] | None:
    """Owner and path of a `Vec3`, if `name` denotes one."""
    found = named_arrays(scene).get(f"{name}.x")
    return None if found is None else (found.owner, found.path[:-1])


def numbered_elements(scene: Scene) -> list[ElasticLine]:
    """The scene's elastic line elements in order; K1 and L1 belong to the first."""
    lines = (e.line_element() for e in scene.effects)
    return [line for line in lines if line is not None and line.elastic]  # type: ignore[misc]


def _long_name(scene: Scene, name: str) -> tuple[str, str]:
    """Expands a short name such as "K1"; returns the full name and its meaning ("value", "strain" or "force")."""
    match = _SHORT.match(name)
    if match is None:
        for meaning in UNITS:
            if name.endswith(f".slack_length.{meaning}"):
                return name.removesuffix(f".{meaning}"), meaning
        return name, "value"
    letter, number, meaning = match.groups()
    elements = numbered_elements(scene)
    letters = {letter for e in elements for letter in _aliases(e)}
    if letter not in letters or (meaning and letter != "L"):
        raise _unknown(scene, name)
    if not 1 <= int(number) <= len(elements):
        numbered = ", ".join(f"{k}{i + 1}" for i in range(len(elements)) for k in sorted(letters))
        found = f"no parameter {name!r}: scene {scene.name!r} has {len(elements)} tendon(s)"
        if lacking := not_pulled(scene):
            remedy = "add the quadriceps to the scene"
            raise InputError("; ".join((found, *lacking)), expected=numbered, remedy=remedy)
        remedy = "name these only, or add the tendon that is missing to the scene"
        raise InputError(found, expected=numbered, remedy=remedy)
    element = elements[int(number) - 1]
    full = f"{element.name}.{_aliases(element)[letter]}"
    if element.count is not None:
        raise InputError(
            f"{name!r} is that of {element.name!r}, a group of {element.count}",
            expected=_expected(full, (element.count,)),
        )
    return full, meaning or "value"


def _aliases(effect: Effect) -> dict[str, str]:
    """Fields of an effect by the letters of their short names."""
    return {q.alias: field for field, q in effect.quantities().items() if q.alias}


def _unknown(scene: Scene, name: str) -> InputError:
    names = [n for n, f in named_arrays(scene).items() if f.owner != "motion"]
    elements = numbered_elements(scene)
    short = [f"{k}{i + 1}" for i, e in enumerate(elements) if e.count is None for k in _aliases(e)]
    near = difflib.get_close_matches(name, [*names, *short], 1, cutoff=0.0)
    return InputError(
        f"no parameter {name!r} in scene {scene.name!r}",
        expected=f"such as {near[0]!r}" if near else None,
        remedy=f"one of: {', '.join([*short, *names][:12])} ...",
    )
