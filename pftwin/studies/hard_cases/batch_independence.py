"""Whether a case's run depends on its place in a batch, or on what runs beside it: run side by side, poisoned."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.integrators import integrator_from_text
from pftwin.studies.hard_cases.batch import CaseBatch
from pftwin.studies.hard_cases.integrators import CaseIntegrator
from pftwin.studies.hard_cases.programs import CaseRun, compiled, poses, run

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
