"""Variants of a batch: a scene, and a row of numbers per variant from which a function changes the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.dynamics.trajectory import checked_scene
from pftwin.model.scene import Scene, check


class Variants(NamedTuple):
    """A scene and a row of numbers per variant.

        Variants(scene, lambda scene, row: treatment.with_values(list(row))(scene), amounts)

    `change(scene, row)` returns a variant's scene, of the same structure for all. As it is traced, it must be pure.
    """

    scene: Scene
    change: Callable[[Scene, Array], Scene]
    values: ArrayLike  # (n, k)


class Group(NamedTuple):
    """Variants that share a program."""

    scene: Scene
    change: Callable[[Scene, Any], Scene]  # a function, or a callable module
    rows: Any  # pytree of arrays (n, ...) on the host
    places: NDArray[np.int64]  # (n,) index of each variant in the whole batch
    names: list[str]  # name of each variant's scene


class _Replaced(eqx.Module):
    """Replaces the leaves of a scene with the indices `which`."""

    which: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, scene: Scene, row: tuple[Array, ...]) -> Scene:
        leaves, structure = jax.tree.flatten(scene)
        for i, value in zip(self.which, row, strict=True):
            leaves[i] = value
        return jax.tree.unflatten(structure, leaves)


def groups_of(scenes: Any) -> list[Group]:
    """Groups variants by the structure of their scene, in order of first appearance.

    Raises:
        InputError: there are no scenes, something is not a scene, a scene is invalid, or `Variants.values` is not a
            finite table.
    """
    if isinstance(scenes, Variants):
        return [_of_variants(scenes)]
    if isinstance(scenes, Scene):
        raise InputError(
            "found a single scene", where="scenes", expected="a list of scenes, or Variants", remedy="pftwin.simulate"
        )
    if not isinstance(scenes, Sequence) or isinstance(scenes, str):
        raise InputError(f"found {scenes!r}", where="scenes", expected="a list of scenes, or Variants")
    if not scenes:
        raise InputError("nothing to simulate", where="scenes", expected="at least one scene")
    alike: dict[Any, list[int]] = {}
    for i, scene in enumerate(scenes):
        check(checked_scene(scene, f"scenes[{i}]"))
        leaves, structure = jax.tree.flatten(scene.unnamed())
        kinds = tuple((a.shape, str(a.dtype)) if eqx.is_array(a) else (type(a), a) for a in leaves)
        alike.setdefault((structure, kinds), []).append(i)
    return [_of_scenes(scenes, places) for places in alike.values()]


def _of_scenes(scenes: Sequence[Scene], places: list[int]) -> Group:
    """A group in which leaves that are equal in all variants are shared, and the others stacked."""
    columns = list(zip(*(jax.tree.leaves(scenes[i].unnamed()) for i in places), strict=True))
    which, rows = [], []
    for k, column in enumerate(columns):
        if not eqx.is_array(column[0]) or all(a is column[0] for a in column):
            continue
        values = [np.asarray(a) for a in column]
        if not all(np.array_equal(a, values[0]) for a in values):
            which.append(k)
            rows.append(np.stack(values))
    if not which:  # all variants are equal: one array must carry their number
        k = next(k for k, column in enumerate(columns) if eqx.is_array(column[0]))
        which, rows = [k], [np.stack([np.asarray(a) for a in columns[k]])]
    names = [scenes[i].name for i in places]
    return Group(scenes[places[0]].unnamed(), _Replaced(tuple(which)), tuple(rows), np.array(places), names)


def _of_variants(given: Variants) -> Group:
    checked_scene(given.scene, "Variants.scene")
    if not callable(given.change):
        raise InputError(f"found {given.change!r}", where="Variants.change", expected="a function of scene and row")
    check(given.scene)
    try:
        values = np.asarray(given.values, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim != 2 or not len(values) or not np.isfinite(values).all():
        found = f"found an array of shape {values.shape}" + ("" if np.isfinite(values).all() else ", not all finite")
        raise InputError(found, where="Variants.values", expected="(n, k) finite numbers, a row for each member")
    scene = given.scene.unnamed()
    made = eqx.filter_eval_shape(given.change, scene, jax.ShapeDtypeStruct(values.shape[1:], float))
    if not isinstance(made, Scene):
        raise InputError(f"gives {type(made).__name__}", where="Variants.change", expected="a scene")
    return Group(scene, given.change, values, np.arange(len(values)), [given.scene.name] * len(values))
