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
from pftwin.studies.hard_cases import Selection, batch, case_named, method_named
from pftwin.studies.hard_cases.batch import CaseBatch
from pftwin.studies.hard_cases.matrix import Prepared, cells_of
from pftwin.studies.hard_cases.programs import Rest, poses

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


def resting(heights: tuple[float, ...]) -> Solution:
    zero, one = jnp.zeros(len(heights)), jnp.ones(len(heights))
    at = Pose(Vec3(zero, zero, jnp.asarray(heights)), Quaternion(one, zero, zero, zero))
    return Solution(at, (), zero, zero, jnp.zeros((len(heights), 6, 6)), zero)


def test_only_a_confirmed_equilibrium_elsewhere_is_taken_for_one(monkeypatch):
    """Of four cases one starts at the same place, one elsewhere, one where nothing balances, and one is let go."""
    double, single = (21e-3, 22e-3, 23e-3, 24e-3), (21e-3 + 1e-5, 22.5e-3, 23.5e-3, 24.5e-3)
    found = (np.nan, 22.5e-3 + 1e-5, 23e-3, np.nan)  # by the search from where the cases in float32 start
    asked = []

    def search(scenes: Any, change: Any, only: list[int]) -> Rest:
        asked.append((only, np.asarray(scenes.start.position.z) - 1e-3))
        return Rest(resting(tuple(found[k] for k in only)), resting((0.0,)), jnp.zeros((len(only), 7, 4)))

    monkeypatch.setattr(batch, "compiled", lambda function, double: search)
    center = Vec3(jnp.zeros(4), jnp.zeros(4), jnp.full(4, -1e-3))  # of mass, 1 mm below the patella's origin
    cases = tuple(SimpleNamespace(released=k == 3, name=str(k)) for k in range(4))
    scenes = Put(resting(double).pose, SimpleNamespace(center_of_mass=center))
    stack: Any = CaseBatch(cases, scenes)  # pyright: ignore[reportArgumentType]
    which, near = batch.other_equilibria(stack, resting(double), resting(single))
    assert which == [1]
    np.testing.assert_allclose(near.pose.position.z, [22.5e-3 + 1e-5])
    ((only, starts),) = asked
    assert only == [1, 2]
    np.testing.assert_allclose(starts, single, rtol=1e-6)


@pytest.mark.slow
def test_a_start_in_another_equilibrium_is_compared_with_a_run_from_there():
    """A button of flat triangles rests on another one in float32, 3.6 mm from there, which is as right."""
    method = method_named("linear_implicit")
    selection = Selection(("contours",), (method,), ("float32",), derivatives=False, batch_independence=False)
    prepared = Prepared([case_named("rest_in_the_groove")], "contours", selection)
    (cell,) = cells_of(prepared, method)
    assert cell.outcome == "pass", cell.reason
    ((_, there),), ((_, own),) = prepared.elsewhere, prepared.stacks("float64")
    ends = [np.asarray(poses(s.chosen.pose))[0] for s in (there, own)]
    assert 0.022 * 2 * np.linalg.norm(ends[0][3:] - ends[1][3:]) > 1e-3  # it has turned by a good part of a triangle
    assert max(float(s.chosen.residual[0]) for s in (there, own)) < 1e-6
