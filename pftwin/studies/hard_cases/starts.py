"""Where runs start: equilibria, found as `pftwin.simulate` finds them, or where a case lets the patella go."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.equilibrium import Solution, tolerance_on_host
from pftwin.dynamics.relaxation import thrown
from pftwin.studies.hard_cases import derivatives
from pftwin.studies.hard_cases.batch import CaseBatch
from pftwin.studies.hard_cases.programs import PARAMETERS, Rest, compiled, relaxed, rest


class Starts(NamedTuple):
    """Of a batch."""

    chosen: Solution
    wrong: dict[str, str]  # by case: what is wrong with its equilibrium


def starts_of(batch: CaseBatch, dtype: str) -> Starts:
    """Solves for all equilibria, with derivatives; where the search fails the damped relaxation helps."""
    double, n = dtype == "float64", len(batch.cases)
    search, nothing = compiled(rest, double), jnp.zeros((n, len(PARAMETERS)))
    found: Rest = search(batch.scenes, nothing)
    scenes, wanted = batch.scenes, np.array([not c.released for c in batch.cases])
    lost = ~_converged(found.equilibrium) & wanted  # one that is let go stays where it was put
    if lost.any():
        there = compiled(relaxed, double)(scenes)
        usable = lost & ~thrown(scenes.start, there)
        scenes = eqx.tree_at(lambda s: s.start, scenes, _where(usable, there, scenes.start))
        again: Rest = search(scenes, nothing)
        found = _where(lost & _converged(again.equilibrium), again, found)
    released = jnp.asarray(~wanted)
    chosen = _where(released, found.released, found.equilibrium)
    return Starts(chosen, _wrong(batch, found, scenes, search, dtype))


def starts_part(starts: Starts, which: list[int]) -> Starts:
    """Those of some of a batch."""
    at = np.asarray(which)
    return Starts(jax.tree.map(lambda a: a[at], starts.chosen), starts.wrong)


def _converged(solution: Solution) -> np.ndarray:
    return np.asarray(solution.residual) < tolerance_on_host(solution)


def _where(which: Any, a: Any, b: Any) -> Any:
    """Of two stacks, by member."""
    chosen = jnp.asarray(which)

    def pick(x: Any, y: Any) -> Any:
        return jnp.where(chosen.reshape((-1,) + (1,) * (jnp.ndim(x) - 1)), x, y)

    return jax.tree.map(pick, a, b)


def _wrong(batch: CaseBatch, found: Rest, scenes: Any, search: Any, dtype: str) -> dict[str, str]:
    """Cases that start from an equilibrium: does the search end, and are its derivatives finite, and right."""
    n, near = len(batch.cases), eqx.tree_at(lambda s: s.start, scenes, _patella_frame(scenes, found.equilibrium))
    said, columns = {}, np.asarray(found.slopes)
    converged = _converged(found.equilibrium)
    reference = None
    if dtype == "float64":
        sides = [
            [_poses(search(near, jnp.tile(jnp.asarray(p), (n, 1))).equilibrium) for p in side]
            for side in derivatives.changes()
        ]
        reference = derivatives.differences(np.stack(sides[0]), np.stack(sides[1]))
    for k, case in enumerate(batch.cases):
        if case.released or not converged[k]:
            continue  # a search that fails is a flag of every frame
        words = derivatives.not_finite(columns[k][None], np.array([True]))
        if words is None and case.expected.smooth and reference is not None:
            words = derivatives.disagree(columns[k], reference[k], dtype)
        if words is not None:
            said[case.name] = f"equilibrium: {words}"
    return said


def _poses(solution: Solution) -> np.ndarray:
    pose = solution.pose
    return np.concatenate([np.asarray(pose.position.array()), np.asarray(pose.orientation.array())], axis=-1)


def _patella_frame(scenes: Any, solution: Solution) -> Any:
    """The equilibria as poses of the patella's frame."""
    from pftwin.base.spatial import Pose

    pose = solution.pose
    return jax.vmap(lambda p, c: Pose(p.apply(-c), p.orientation))(pose, scenes.patella.center_of_mass)
