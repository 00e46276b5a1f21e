"""Measurements in other units, signs or axes, swapped or late: named before any number, refused where far off."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from lifted_fits import COMPUTED as USE
from lifted_fits import SPRINGS
from small_scene import small_scene

import fitting
import pftwin
from fitting.channel_checks import LIMITS, readings
from fitting.estimate import Estimate
from fitting.evaluation import Evaluator
from fitting.objective import Objective
from pftwin.base.errors import InputError
from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.files.mocap.poses import PoseSeries
from pftwin.model.measured import Measured
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene

FRAMES, PERIOD = 41, 0.3  # as many as in other tests: the same programs; of the motion [s]
TRUTH = np.array([156.0, 0.1432, 629.0, 0.0714]) * np.array([1.1, 0.97, 0.92, 1.02])
FORCES = ("contact_force", "femoral_spring_force", "tibial_spring_force")


@cache
def scene() -> Scene:
    """Bent to and fro so often that so few frames tell of a shift in time."""
    times = 0.01 * np.arange(FRAMES)
    flexion = np.radians(45 + 10 * np.sin(2 * np.pi * times / PERIOD))
    q = tibiofemoral_orientation(flexion, np.full(FRAMES, 0.05), np.full(FRAMES, -0.03))
    tibia = PoseSeries(times, np.zeros((FRAMES, 3)), np.stack([q.w, q.x, q.y, q.z], axis=1))
    return replace(small_scene(FRAMES), motion=KneeMotion.from_poses(None, tibia))


@cache
def truth(late: float = 0.0) -> Measured:
    """The motion with other springs than nominal; late by so much [s]."""
    twin = fitting.free_parameters(scene(), SPRINGS).apply(scene(), TRUTH)
    r = pftwin.simulate(twin, dt=1 / 600)
    random = np.random.default_rng(0)

    def with_noise(values: np.ndarray, noise: float) -> np.ndarray:
        columns = np.reshape(values, (len(r.times), -1))
        then = np.stack([np.interp(r.times - late, r.times, c) for c in columns.T], axis=1)
        return np.reshape(then, np.shape(values)) + random.normal(0.0, noise, np.shape(values))

    force = {"contact": "force", "quadriceps": "tension", "patellar_tendon": "tension"}
    forces = [with_noise(np.asarray(r.effects[name][what]), 0.02) for name, what in force.items()]
    return Measured(r.times, with_noise(r.center, 1e-4), None, forces[0], forces[2], forces[1], source="cells")


def forces(change) -> Measured:
    return replace(truth(), **{name: change(getattr(truth(), name)) for name in FORCES})


def fit(measured: Measured, use=USE, **more) -> Estimate:
    return fitting.fit_tendons(scene(), measured, use=use, starts=4, computed=USE, **more)


def test_what_is_right_is_fitted_without_a_doubt():
    found = fit(truth())
    assert found.doubts == []
    np.testing.assert_allclose(found.values, TRUTH, rtol=0.02)
    assert found.sentence().startswith("position, contact, quadriceps, patellar_tendon give K1")
    assert abs(found.time_shifts["position"][0]) < 1e-3


# Whether the contact's force is among them is decided by how this processor rounds an impact.
TENSIONS = "measured (contact, )?quadriceps and patellar_tendon look"
ALL = "measured contact, quadriceps and patellar_tendon look"


@pytest.mark.parametrize(
    ("measured", "said"),
    [
        (lambda: forces(lambda f: 1000 * f), f"{ALL} 1000 times too large"),
        (lambda: forces(lambda f: f / 1000), f"{TENSIONS} 1000 times too small: in kilonewtons"),
        (lambda: forces(np.negative), f"{ALL} negated"),
        (lambda: forces(lambda f: f / 4.4482216), f"{TENSIONS} 4.45 times too small: in pounds-force"),
        (
            lambda: replace(
                truth(),
                femoral_spring_force=truth().tibial_spring_force,
                tibial_spring_force=truth().femoral_spring_force,
            ),
            "measured quadriceps and patellar_tendon look swapped",
        ),
        (lambda: replace(truth(), center=1000 * truth().center), "positions look 1000 times too large: in millimetres"),
        (lambda: replace(truth(), center=truth().center / 1000), "positions look 1000 times too small"),
        (lambda: replace(truth(), center=truth().center * [1, -1, 1]), r"like \(x, -y, z\) .* \(mirrored\)"),
        (
            lambda: replace(truth(), center=truth().center[:, [2, 1, 0]]),
            r"like \(z, y, x\) in the place of \(x, y, z\)",
        ),
    ],
    ids=["x1000", "kN", "negated", "pounds", "swapped", "mm", "/1000", "mirrored", "x-z"],
)
def test_other_units_signs_and_axes_are_refused_by_name(measured, said):
    with pytest.raises(InputError, match=said) as refused:
        fit(measured())
    assert "cells" in str(refused.value)
    assert "correct the file" in str(refused.value)


@pytest.mark.parametrize("channel", ["position", "quadriceps"])
def test_a_shift_in_time_is_estimated_and_named_before_any_number(channel, tmp_path):
    late = truth(0.03)
    if channel == "quadriceps":
        late = replace(truth(), femoral_spring_force=late.femoral_spring_force)
    found = fit(late, ("position", "quadriceps") if channel == "quadriceps" else ("position",))
    shift, deviation = found.time_shifts[channel]
    assert shift == pytest.approx(0.03, abs=0.003)
    assert deviation < 0.002
    assert len(found.doubts) == 1
    first = found.summary().splitlines()[0]
    assert first == found.sentence()
    assert first.startswith(f"INVALID: measured {channel} is {1e3 * shift:.0f} ms")
    assert "fix" not in first
    content = json.loads(found.save(tmp_path / "fit.json").read_text())
    assert list(content)[:3] == ["format", "sentence", "doubts"]
    assert content["doubts"] == found.doubts
    assert ((found.intervals[:, 0] < TRUTH) & (found.intervals[:, 1] > TRUTH)).all()
    assert Estimate.load(tmp_path / "fit.json").to_dict() == found.to_dict()


def test_a_shift_beyond_the_limit_is_refused_and_limits_are_the_users():
    with pytest.raises(InputError, match=r"measured position is .* ms .* late .*limit 'shift'"):
        fit(truth(0.03), ("position",), limits={"shift": (0.01, 0.02)})
    assert fit(truth(0.03), ("position",), limits={"shift": (0.05, 0.1)}).doubts == []
    with pytest.raises(InputError, match="no limit 'shifts'"):
        fit(truth(), limits={"shifts": (1.0, 2.0)})
    with pytest.raises(InputError, match="two positive numbers"):
        fit(truth(), limits={"shift": (2.0, 1.0)})


def test_residuals_that_no_reading_explains_are_reported_or_refused():
    """A spring's force with half of its size missing in every other frame: within no bound of the parameters."""
    odd = truth().femoral_spring_force * np.where(np.arange(FRAMES) % 2, 0.5, 1.0)
    broken = replace(truth(), femoral_spring_force=odd)
    named = fit(broken, ("position", "quadriceps"))
    assert named.sentence().startswith("INVALID: residual of quadriceps: ")
    with pytest.raises(InputError, match=r"residual of quadriceps: .* N rms .*limit 'force'"):
        fit(broken, ("position", "quadriceps"), limits={"force": (0.1, 0.2)})
    with pytest.raises(InputError, match=r"times the stated noise.*limit 'noise'"):
        fit(broken, ("position", "quadriceps"), noise={"position": 1e-4, "quadriceps": 1e-3})


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_rigs_own_measurements_raise_no_doubt_and_faulty_ones_do(n):
    """Its plant differs from the twin in springs, attachments, friction and surface; markers and cells are noisy."""
    case = pftwin.rig.case(n, contact="P5")
    m, computed = pftwin.rig.measured(n), fitting.channels_of(case)
    for use in ("position", ("position", "quadriceps"), "all"):
        assert fitting.fit_tendons(case, m, use=use, computed=computed).doubts == []
    target = Objective.of(case, m, use="all")
    free = fitting.free_parameters(case, SPRINGS)
    evaluator = Evaluator(case, free, target.channels, computed=computed)
    evaluator.prepare(None)
    trials = evaluator.with_slopes(
        np.concatenate([free.nominal[None], free.latin_hypercube(31, np.random.default_rng(1))]), 2
    )
    assert m.tibial_spring_force is not None
    faulty = replace(m, femoral_spring_force=m.tibial_spring_force, tibial_spring_force=m.femoral_spring_force)
    for data, limit in ((m, 1.05), (faulty, LIMITS["reading"][1])):
        with_noise = [r.times for r in readings(Objective.of(case, data, use="all"), trials.values[trials.usable])]
        assert (max(with_noise, default=1.0) > limit) == (data is faulty)
    late = replace(m, center=m.center[np.maximum(np.arange(len(m.times)) - 3, 0)])
    assert "measured position is" in fitting.fit_tendons(case, late, computed=computed).sentence()


@pytest.fixture(scope="module")
def late_by_30_ms():
    """The springs of the rig's twin, and their fit from positions that come 30 ms late."""
    case = pftwin.rig.case(2, contact="P5")
    free = fitting.free_parameters(case, SPRINGS)
    true = free.nominal * np.array([1.1, 0.97, 0.92, 1.02])
    r = pftwin.simulate(free.apply(case, true), integrator=pftwin.LinearImplicit(), dt=2.5e-3)  # as fits take them
    late = np.stack([np.interp(r.times - 0.03, r.times, c) for c in r.center.T], axis=1)
    late += np.random.default_rng(3).normal(0.0, 2e-4, late.shape)
    return true, fitting.fit_tendons(case, Measured(r.times, late), starts=16, computed=fitting.channels_of(case))


@pytest.mark.slow
def test_positions_of_the_rigs_twin_30_ms_late_are_not_confident_and_wrong(late_by_30_ms):
    """Unnamed they put K1 and K2 off by 23 % with 95 % intervals of 5 %."""
    true, found = late_by_30_ms
    assert np.abs(found.values / true - 1).max() > 0.15
    assert found.time_shifts["position"][0] == pytest.approx(0.03, abs=1e-3)
    assert found.sentence().startswith("INVALID: measured position is ")
    assert ((found.intervals[:, 0] < true) & (found.intervals[:, 1] > true)).all()


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="said as 29 +- 0.6 ms: linearised where K1 is 18 % off")
def test_the_shift_of_30_ms_is_said(late_by_30_ms):
    assert late_by_30_ms[1].sentence().startswith("INVALID: measured position is 30 ms")
