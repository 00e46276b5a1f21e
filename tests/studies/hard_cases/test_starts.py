"""Starts of a batch: those whose search fails are relaxed, and those that are let go stay where they were put."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import relaxed_start
from pftwin.studies.hard_cases import batch
from pftwin.studies.hard_cases.batch import CaseBatch
from pftwin.studies.hard_cases.programs import Rest

HIGH, LOW = 22.5e-3, 21.9e-3  # where both are put, and where they come to rest [m]


class Put(NamedTuple):
    """What a stack of scenes is asked for here."""

    start: Pose
    patella: Any


def pose(height: float) -> Pose:
    one, zero = jnp.ones(2), jnp.zeros(2)
    return Pose(Vec3(zero, zero, height * one), Quaternion(one, zero, zero, zero))


def solution(at: Pose, residual: float) -> Solution:
    left = jnp.full(2, residual)
    return Solution(at, (), left, jnp.zeros(2, int), jnp.zeros((2, 6, 6)), jnp.zeros(2))


def searched(scenes: Put, change: Any) -> Rest:
    """Fails for both from on high, and ends for both where one starts from down there."""
    residual = 5.0 if float(scenes.start.position.z.min()) == HIGH else 1e-9
    return Rest(solution(scenes.start, residual), solution(scenes.start, np.inf), jnp.zeros((2, 7, 4)))


@pytest.mark.parametrize("wanted", [True, False])
def test_a_case_that_is_let_go_stays_where_it_was_put(monkeypatch, wanted):
    """It had the relaxed place, already fallen, wherever another case of its batch had to be relaxed."""

    monkeypatch.setattr(
        batch,
        "compiled",
        lambda function, double: (lambda scenes: pose(LOW)) if function is relaxed_start else searched,
    )
    monkeypatch.setattr(batch, "_failing_equilibria", lambda *given: {})
    cases = tuple(SimpleNamespace(released=r, name=n) for r, n in ((not wanted, "one"), (True, "let go")))
    scenes = Put(pose(HIGH), None)
    chosen = batch.starts_of(CaseBatch(cases, scenes), "float32").chosen  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(chosen.pose.position.z, [LOW if wanted else HIGH, HIGH])
