"""Estimated errors: closed forms, what is flagged, which steps are taken, and what a result holds of them."""

from __future__ import annotations

import json

import equinox as eqx
import numpy as np
import pytest
from small_scene import small_scene
from typer.testing import CliRunner

import pftwin
from pftwin.cli import app
from pftwin.dynamics.error_estimate import Course, error_of
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import Tolerance, Tried, accurate_enough, coarsest, most_runs, with_estimate
from pftwin.files.result_files import load_dataset

N_FRAMES = 5
AT_FRAME = np.array([0.0, 1.0, 0.0, 0.0, 0.5])  # errors are in one frame and half as large in another


def course(place: float = 0.0, force: float = 0.0, shift: float = 0.0, peak: float = 20.0) -> Course:
    """20 N on the button, and off by so much: in place [m], in force, and in what the lateral facet bears alone [N]."""
    center = np.zeros((N_FRAMES, 3))
    center[:, 1] = place * AT_FRAME
    pressed = np.zeros((N_FRAMES, 3))
    pressed[:, 2] = peak + force * AT_FRAME
    medial = np.full(N_FRAMES, peak / 2)
    return Course(center, np.tile([1.0, 0, 0, 0], (N_FRAMES, 1)), pressed, medial, medial + shift * AT_FRAME)


def falling(place: float, force: float):
    """Runs whose errors fall with the step (place) and with its root (force); both are given for 1 ms of 10 ms."""
    made: list[int] = []

    def run(n: int) -> Tried[int]:
        made.append(n)
        return Tried(n, course(place * 10 / n, force * (10 / n) ** 0.5), True)

    return run, made


@pytest.mark.parametrize("ratio", [2.0, 2.5])
def test_the_estimate_is_the_error_where_errors_fall_as_assumed(ratio):
    """Place with the step, force with its root."""
    coarse, fine = course(ratio * 1e-4, ratio**0.5 * 3.0, ratio**0.5), course(1e-4, 3.0, 1.0)
    found = error_of(fine, coarse, BDF2().order, ratio)
    np.testing.assert_allclose(found.path, 1e-4 * AT_FRAME, rtol=1e-12)
    np.testing.assert_allclose(found.contact_force, 3.0 * AT_FRAME, rtol=1e-12)
    np.testing.assert_allclose(found.lateral_facet, AT_FRAME, rtol=1e-12)
    np.testing.assert_array_equal(found.medial_facet, 0.0)
    before = error_of(coarse, fine, BDF2().order, 1 / ratio)
    np.testing.assert_allclose(before.path, ratio * 1e-4 * AT_FRAME, rtol=1e-12)
    np.testing.assert_allclose(before.contact_force, ratio**0.5 * 3.0 * AT_FRAME, rtol=1e-12)


def test_first_order_trusts_less():
    """Half of order one: the root of the step."""
    found = error_of(course(1e-4), course(2e-4), LinearImplicit().order, 2.0)
    np.testing.assert_allclose(found.path, 1e-4 * AT_FRAME / (2**0.5 - 1))


def pair(**off: float) -> np.ndarray:
    """Flags where two runs are so far apart that this is the estimate of the finer one."""
    root = 2**0.5 - 1
    scaled = {name: value * (1.0 if name == "place" else root) for name, value in off.items() if name != "peak"}
    peak = {"peak": off["peak"]} if "peak" in off else {}
    return error_of(course(**peak), course(**scaled, **peak), BDF2().order, 2.0).flags


@pytest.mark.parametrize(
    ("off", "flags"),
    [
        ({"place": 0.49e-3}, [0, 0, 0, 0, 0]),
        ({"place": 0.51e-3}, [0, 512, 0, 0, 0]),
        ({"place": 2.01e-3}, [0, 512, 0, 0, 512]),
        ({"force": 3.99}, [0, 0, 0, 0, 0]),  # 20 % of 20 N
        ({"force": -4.1}, [0, 512, 0, 0, 0]),
        ({"force": 4.99, "peak": 100.0}, [0, 0, 0, 0, 0]),  # 5 N
        ({"force": 5.01, "peak": 100.0}, [0, 512, 0, 0, 0]),
        ({"shift": 4.01}, [0, 1024, 0, 0, 0]),
        ({"force": 0.04, "peak": 0.01}, [0, 0, 0, 0, 0]),  # next to nothing
        ({"force": 9.9, "peak": 10.0}, [0, 512, 0, 0, 512]),
        ({"force": 10.1, "peak": 10.0}, [0, 512 + 4096, 0, 0, 512]),  # the largest force is not known at all
        ({"place": np.nan}, [512, 512, 512, 512, 512]),
    ],
    ids=str,
)
def test_what_is_flagged(off, flags):
    np.testing.assert_array_equal(pair(**off), flags)


def test_only_the_error_of_the_largest_force_leaves_it_unknown():
    """A spike of 30 N that another run lacks; a lift-off there instead of 1 N may be as wrong without harm."""
    spike = error_of(course(force=10.0), course(force=-2.5), BDF2().order, 2.0).flags
    np.testing.assert_array_equal(spike, [0, 512 + 4096, 0, 0, 512])
    small = error_of(course(force=-19.0), course(force=-11.0), BDF2().order, 2.0)
    assert small.contact_force[1] > 1.0
    np.testing.assert_array_equal(small.flags, [0, 512, 0, 0, 512])


@pytest.mark.parametrize(
    ("place", "force", "steps"),
    [(0.2e-3, 0.0, 10), (0.45e-3, 0.0, 20), (3e-3, 0.0, 40), (0.0, 1.9, 10), (0.0, 4.2, 20), (0.0, 30.0, 40)],
)
def test_steps_are_halved_until_the_error_is_small(place, force, steps):
    """From 1 ms: estimates of 0.5 mm and 4 N are small; one from a single pair counts double; two halvings at most."""
    run, made = falling(place, force)
    found = accurate_enough(run, 10, BDF2().order)
    assert (found.run, found.substeps) == (steps, steps)
    assert made == [n for n in (5, 10, 20, 40) if n <= steps]
    known = place * 10 / steps, force * (10 / steps) ** 0.5
    factor = 2 if steps == 10 else 1
    largest = found.error.largest
    assert (largest["path"], largest["contact_force"]) == pytest.approx([factor * k for k in known])
    assert found.error.small == (known[0] <= 0.5e-3 and known[1] <= 4)


def test_two_runs_that_agree_by_chance_do_not_convince():
    """The pair before was far apart: half the step can have mended but so much of it."""
    forces = {5: 0.0, 10: 20.0, 20: 20.0, 40: 20.0}
    found = accurate_enough(lambda n: Tried(n, course(force=forces[n]), True), 10, BDF2().order)
    assert found.substeps == 40
    assert found.error.small
    once = 20 / (2**0.5 - 1)
    early = accurate_enough(lambda n: Tried(n, course(force=forces[min(n, 20)] if n != 20 else 20.0), True), 10, 2)
    assert early.substeps == 40
    assert once / 2**0.5 > 4  # what the first pair leads to expect at 20


def test_runs_that_do_not_count_leave_the_error_unknown():
    run, _ = falling(0.0, 0.0)
    found = accurate_enough(lambda n: run(n)._replace(sound=n >= 40), 10, 2)
    assert found.substeps == 40
    assert np.isinf(found.error.path).all()
    assert (found.error.flags == int(Status.INACCURATE | Status.FACETS_INACCURATE)).all()


@pytest.mark.parametrize(("n", "sound_from", "made"), [(10, 1, [10, 5]), (10, 10, [10, 5, 20]), (1, 1, [1, 2])])
def test_given_steps_are_not_changed(n, sound_from, made):
    """Half as many steps tell the error; twice as many where they do not, or where they say that it is large."""
    run, seen = falling(1e-4, 1.0)
    found = with_estimate(lambda k: run(k)._replace(sound=k >= sound_from), n, BDF2().order)
    assert (found.run, seen) == (n, made)
    assert found.error.largest["path"] == pytest.approx(1e-4 * 10 / n)


def stiff() -> pftwin.Scene:
    """A small knee whose contact is ten thousand times as stiff as usual, without damping of its tendons."""
    scene = small_scene()
    button = scene.contact
    scene = scene.with_effect(
        eqx.tree_at(lambda c: c.law.contact_stiffness, button, button.law.contact_stiffness * 1e4)
    )
    for name in ("quadriceps", "patellar_tendon"):
        scene = scene.set(f"{name}.damping", 0.0)
    return scene


@pytest.fixture(scope="module")
def true():
    """From steps of 1/64 ms."""
    return pftwin.simulate(stiff(), dt=1e-2 / 640)


def off(result: pftwin.Result, true: pftwin.Result) -> tuple[float, float]:
    """Largest errors of place [m] and of contact force [N]."""
    place = np.linalg.norm(result.center - true.center, axis=1).max()
    return place, np.linalg.norm(result.contact_force - true.contact_force, axis=1).max()


def test_a_result_that_is_off_is_flagged(true):
    """5 ms are too long for this scene, in force; 0.1 ms are right."""
    long = pftwin.simulate(stiff(), dt=5e-3)
    assert off(long, true)[1] > 0.2 * np.linalg.norm(true.contact_force, axis=1).max()
    assert Status.INACCURATE in long.status
    assert long.settings["dt_s"] == 5e-3
    short = pftwin.simulate(stiff(), dt=1e-4)
    assert not short.status & (Status.INACCURATE | Status.FACETS_INACCURATE)
    errors = off(short, true)
    assert errors[0] < short.error.largest["path"]
    assert errors[1] < short.error.largest["contact_force"]


@pytest.mark.slow
def test_a_motion_whose_peak_is_a_spike_is_invalid():
    """Springs of case 1 a few per cent off, in steps of 2.5 ms: a single frame has hundreds of newtons (826 as users'
    programs are compiled, where too few frames are inaccurate to make the motion INVALID), converged runs have 27."""
    scene = pftwin.rig.case(1)
    for name, factor in (("K1", 1.05), ("K2", 0.95), ("L1", 0.97), ("L2", 0.99)):
        scene = scene.set(name, factor * scene.get(name))
    long = pftwin.simulate(scene, integrator=LinearImplicit(), dt=2.5e-3)
    assert np.linalg.norm(long.contact_force, axis=1).max() > 100
    assert Status.PEAK_UNKNOWN in long.verdict.flags
    assert "the estimated error of the largest contact force is as large as this force" in long.tracking
    fine = pftwin.simulate(scene, dt=1e-4)
    assert fine.verdict.valid
    assert np.linalg.norm(fine.contact_force, axis=1).max() == pytest.approx(27, abs=1)


def test_by_default_steps_follow_the_error(true):
    """The small knee is right at 1 ms; the stiff one is not, and gets a quarter."""
    plain = pftwin.simulate(small_scene())
    assert (plain.settings["integrator"], plain.settings["substeps"]) == (BDF2().text, 10)
    assert plain.status == Status.OK
    found = pftwin.simulate(stiff())
    assert found.settings["substeps"] > 10
    place, force = off(found, true)
    assert place < found.error.largest["path"]
    assert force < found.error.largest["contact_force"]


def test_results_show_the_estimate(tmp_path):
    found = pftwin.simulate(small_scene(), dt=5e-3)
    found.save(tmp_path / "found.nc")
    data = load_dataset(tmp_path / "found.nc")
    np.testing.assert_array_equal(data["estimated_error_path"], found.error.path)
    np.testing.assert_array_equal(data["estimated_error_medial_facet"], found.error.medial_facet)
    assert data["estimated_error_contact_force"].attrs["units"] == "N"
    assert "inaccurate" in data["status"].attrs["flag_meanings"].split()
    path, force = (found.error.largest[name] for name in ("path", "contact_force"))
    assert f"estimated error, at most: {1e3 * path:.2g} mm of path, {force:.2g} N of contact force" in found.summary()


@pytest.mark.slow
def test_the_command_line_shows_the_estimate(tmp_path):
    run = CliRunner().invoke(
        app, ["simulate", "--case", "1", "-o", str(tmp_path / "a.nc"), "--json", "-", "--dt", "0.005"]
    )
    shown = json.loads(run.stdout)["estimated_error"]
    assert shown["path_m"] < 1e-3
    assert shown["contact_force_N"] > 4  # 5 ms are too long for forces
    assert run.exit_code == 3


@pytest.mark.slow
def test_little_damping_by_default():
    """Case 2 without drag: in steps of 1 ms linear_implicit was 4.7 mm off, without a word."""
    scene = pftwin.rig.case(2).without("damping")
    true = pftwin.simulate(scene, dt=1e-2 / 320)
    assert off(pftwin.simulate(scene), true)[0] < 1e-3
    damped = pftwin.simulate(scene, integrator=LinearImplicit(), dt=1e-3)
    assert off(damped, true)[0] > 3e-3
    assert Status.INACCURATE in damped.status


def test_a_tolerance_of_force_is_held():
    """The largest error of all frames, against steps of 1/64 ms."""
    scene = small_scene()
    found = pftwin.simulate(scene, tolerance="0.02 N")
    assert found.settings["tolerance_held"]
    assert found.settings["estimated_error_N"] <= found.settings["tolerance_N"] == 0.02
    assert off(found, pftwin.simulate(scene, dt=1e-2 / 640))[1] < 0.02


@pytest.mark.parametrize("n", [1, 2, 5, 10])
@pytest.mark.filterwarnings("ignore:a tolerance")
def test_a_scene_that_is_never_accurate_needs_the_most_runs_and_one_that_always_is_the_first_two(n):
    """So the time left is that of the worst case, and the first two can run at the same time."""
    for error in (1.0, 0.0):  # [m], of a step as long as the interval between frames
        made: list[list[int]] = [[], [], []]

        def run(k: int, which: int, error: float = error, made: list[list[int]] = made) -> Tried[int]:
            made[which].append(k)
            return Tried(k, course(place=error / k), True)

        with_estimate(lambda k: run(k, 0), n, BDF2().order)
        accurate_enough(lambda k: run(k, 1), 2 * n, BDF2().order)
        coarsest(lambda k: run(k, 2), BDF2().order, Tolerance(1e-9, "m"))
        most = [
            most_runs(n, fixed=True, tolerance=False),
            most_runs(2 * n, fixed=False, tolerance=False),
            most_runs(n, fixed=False, tolerance=True),
        ]
        assert made == (most if error else [numbers[:2] for numbers in most])


def test_simulate_tells_which_run_it_is_and_the_steps_done():
    """Five intervals between frames, in 1, 2, 4, ..., 256 steps each until the tolerance is met."""
    calls: list[tuple[int, int, str]] = []
    result = pftwin.simulate(small_scene(6), tolerance="0.1 um", progress=lambda *counts: calls.append(counts))
    assert calls[:2] == [(0, 2555, "runs 1 and 2 of at most 9"), (15, 2555, "run 3 of at most 9")]
    assert [done for done, _, _ in calls[1:]] == [5 * (2**k - 1) for k in range(2, 1 + len(calls))]
    assert result.settings["substeps"] == 2 ** (len(calls) - 1)
