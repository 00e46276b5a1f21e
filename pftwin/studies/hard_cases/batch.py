"""Cases made into scenes and stacked, and those that are refused instead.

Whether a case's run depends on its place in a batch, or on what runs beside it: run side by side, poisoned.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.errors import InputError
from pftwin.dynamics.frame_states import substeps_for
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.model.scene import Scene, check
from pftwin.studies.hard_cases.case import CaseIntegrator, HardCase
from pftwin.studies.hard_cases.contacts import contact_on
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.programs import CaseRun, compiled, poses, run


class CaseBatch(NamedTuple):
    """Cases of one structure, one behind the other along the leading axis of every array."""

    cases: tuple[HardCase, ...]
    scenes: Scene


def built(case: HardCase, contact: str) -> Scene:
    """The case as a scene that may be simulated.

    Raises:
        InputError: what the case is refused with.
    """
    knee = case.builder()
    scene = knee.scene(contact_on(knee, contact), case.name)
    check(scene)
    return scene


def batches(cases: Sequence[HardCase], contact: str) -> tuple[list[CaseBatch], dict[str, InputError]]:
    """The cases that run with a kind of contact, by group, and why the others are refused."""
    groups: dict[str, list[tuple[HardCase, Scene]]] = {}
    refused: dict[str, InputError] = {}
    for case in cases:
        if contact not in case.contacts:
            continue
        try:
            scene = built(case, contact).unnamed()
        except InputError as error:
            refused[case.name] = error
        else:
            groups.setdefault(case.group, []).append((case, scene))
    return [CaseBatch(tuple(c for c, _ in g), stacked([s for _, s in g])) for g in groups.values()], refused


def stacked(trees: Sequence[Any]) -> Any:
    """Values of one structure as one, with a leading axis.

    Raises:
        InputError: values of several structures, by the first that differs.
    """
    first = _shapes(trees[0])
    for k, tree in enumerate(trees):
        if (other := _shapes(tree)) != first:
            wrong = [f"{a} and {b}" for a, b in zip(first[1], other[1], strict=False) if a != b]
            raise InputError(
                f"number {k} is not like the first: {wrong[0] if wrong else 'another tree'}", where="cases of one group"
            )
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x) for x in leaves]), *trees)


def _shapes(tree: Any) -> tuple[Any, list[Any]]:
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(np.shape(x), np.asarray(x).dtype) for x in leaves]


def member(tree: Any, k: int) -> Any:
    """One of a stack, on the host."""
    return jax.tree.map(lambda a: np.asarray(a)[k], tree)


def steps_of(case: HardCase, method: CaseIntegrator) -> int:
    """Steps within a frame."""
    return substeps_for(1 / RATE, min(case.step, method.longest_step))


def short_enough(batch: CaseBatch, method: CaseIntegrator) -> list[int]:
    """Which of a batch's cases need no more steps than a method is given."""
    frames = batch.scenes.motion.n_frames
    most = method.most_steps
    return [k for k, c in enumerate(batch.cases) if most is None or (frames - 1) * steps_of(c, method) <= most]


def part(batch: CaseBatch, which: list[int]) -> CaseBatch:
    """Some of a batch."""
    at = np.asarray(which)
    return CaseBatch(tuple(batch.cases[k] for k in which), jax.tree.map(lambda a: a[at], batch.scenes))


LARGEST = 2000  # steps of a run that is looked at: side by side all take as many as the longest
AGREE = {"float64": 1e-10, "float32": 1e-4}  # of poses side by side with different mates [m, quaternion components]


def batch_mates(
    batch: CaseBatch, starts: Any, substeps: Any, plain: CaseRun, method: CaseIntegrator, dtype: str
) -> dict[str, str]:
    """By case: what differs.

    All cases run side by side (`jax.vmap`), in reversed order with every second one NaN in all its numbers, and then
    with the others NaN. What is left has to be what the undisturbed batch, in its own order, gives.
    """
    if not method.side_by_side:
        return {}
    n = len(batch.cases)
    program = compiled(run, dtype == "float64", side_by_side=True, integrator=integrator_from_text(method.name))
    frames = np.asarray(plain.seen.status).shape[1] - 1
    steps = jnp.minimum(substeps, max(1, LARGEST // frames))
    args = (batch.scenes, starts, steps, jnp.zeros((n, 4)))
    alone = np.asarray(poses(program(*args).states))
    back = np.arange(n)[::-1]
    said: dict[str, str] = {}
    for parity in (0, 1):
        poison = jnp.asarray(back % 2 == parity)
        turned = jax.tree.map(lambda a: a[jnp.asarray(back)], args)
        spoiled = (_poisoned(turned[0], poison), *turned[1:])
        mixed = np.asarray(poses(program(*spoiled).states))[back]
        for k, case in enumerate(batch.cases):
            if k % 2 == parity:
                continue
            off = np.abs(mixed[k] - alone[k])
            off = np.where(np.isnan(mixed[k]) & np.isnan(alone[k]), 0.0, off).max()
            if not off <= AGREE[dtype]:
                said[case.name] = f"depends on its batch: {off:.1g} off"
    return said


def _poisoned(scenes: Any, which: Any) -> Any:
    """Numbers of the chosen members made NaN; whole numbers, which are a mesh's order, stay."""

    def spoil(a: Any) -> Any:
        if not eqx.is_inexact_array(a):
            return a
        return jnp.where(which.reshape((-1,) + (1,) * (a.ndim - 1)), jnp.nan, a)

    return jax.tree.map(spoil, scenes)
