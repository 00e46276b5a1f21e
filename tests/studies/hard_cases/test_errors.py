"""How far runs are off: what a converged run says of them, and whether they say so themselves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

import pftwin
from pftwin.base.spatial import Quaternion, Vec3
from pftwin.dynamics.error_estimate import Course, course_difference
from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases import case_named, method_named
from pftwin.studies.hard_cases.batch import built_scene
from pftwin.studies.hard_cases.invariants import ERRORS
from pftwin.studies.hard_cases.verdict import Truth, silent_error

FRAMES = 40


def course(*, shift: float = 0.0, frames: int = FRAMES, force: float = 20.0, medial: float = 12.0) -> Course:
    """A button 5 mm beside the middle that is shifted [m] from some frame on."""
    center = np.tile([0.0, 5e-3, 0.05], (FRAMES, 1))
    center[FRAMES - frames :, 0] += shift
    turn, one = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1)), np.ones(FRAMES)
    return Course(center, turn, np.outer(one, [0.0, 0.0, force]), medial * one, (force - medial) * one)


def ran(of: Course, *flags: Status) -> Any:
    """A run of that course, with flags in its first frames."""
    x, y, z = of.center.T
    w, i, j, k = of.quaternion.T
    report = dict(zip(("force_x", "force_y", "force_z"), of.force.T, strict=True))
    report |= {"force_medial": of.medial, "force_lateral": of.lateral}
    observation = SimpleNamespace(
        center=Vec3(x, y, z),
        patella=SimpleNamespace(orientation=Quaternion(w, i, j, k)),
        effects={"contact": report},
        status=np.array([*(int(f) for f in flags), *[0] * (FRAMES - len(flags))]),
    )
    return SimpleNamespace(observation=observation)


def truth(left: float = 0.0) -> Truth:
    """The course without a shift, known to so much [m]."""
    return Truth(course(), course_difference(course(), course(shift=left)))


def test_a_right_run_has_nothing_to_say():
    assert silent_error(ran(course(shift=0.5e-3)), truth()) is None


@pytest.mark.parametrize("off", [course(shift=3e-3), course(force=26.0)])
def test_a_run_that_is_off_has_to_say_so_in_some_frame(off):
    assert "and no frame says so" in str(silent_error(ran(off), truth()))
    assert "and no frame says so" in str(silent_error(ran(off, Status.LEFT_PATCH), truth()))


def test_one_frame_that_says_so_does_not_make_up_for_many_that_are_off():
    few, many = course(shift=3e-3, frames=4), course(shift=3e-3, frames=5)
    assert silent_error(ran(few, Status.INACCURATE), truth()) is None
    assert f"in 5 of {FRAMES} frames" in str(silent_error(ran(many, Status.INACCURATE), truth()))
    assert silent_error(ran(many, *[Status.INACCURATE] * 5), truth()) is None  # then the verdict is INVALID


def test_forces_of_facets_may_be_off_where_frames_say_so():
    unshared = course(medial=2.0)
    assert "no frame says so" in str(silent_error(ran(unshared), truth()))
    assert silent_error(ran(unshared, Status.FACETS_INACCURATE), truth()) is None


def test_no_flag_that_only_errors_raise_is_forbidden():
    """A run that is off in place and, by more than its largest force, in force raises them all."""
    made = course_difference(course(), course(shift=3e-3, force=-25.0)).flags
    assert int(np.bitwise_or.reduce(made)) == int(ERRORS)


def test_in_the_plane_of_symmetry_the_facet_is_not_judged():
    middle, other = (c._replace(center=c.center * [1, 0, 1]) for c in (course(medial=20.0), course(medial=0.0)))
    assert silent_error(ran(other), Truth(middle, course_difference(middle, middle))) is None


def test_what_is_not_known_of_the_truth_is_not_held_against_a_run():
    assert silent_error(ran(course(shift=3e-3)), truth(left=1.2e-3)) is None
    assert silent_error(ran(course(shift=3e-3)), truth(left=0.9e-3)) is not None


def test_a_run_is_right_only_if_it_is_so_whatever_of_the_truth_is_not_known():
    near = ran(course(shift=0.7e-3))  # 1 mm is allowed
    assert truth(left=0.1e-3).finds_right(near)
    assert not truth(left=0.2e-3).finds_right(near)
    assert not truth().finds_right(ran(course(force=26.0)))
    assert truth().finds_right(ran(course(shift=3e-3, frames=4)))  # a verdict allows as many frames
    assert not truth().finds_right(ran(course(shift=3e-3, frames=5)))


@pytest.mark.slow
def test_single_precision_says_that_a_hard_contact_leaves_the_place_open():
    """1e11 N/m^1.5: rounding of places is 0.3 N of load, and that up to 10 mm along the groove."""
    for name, double, flagged in (
        ("contact_hard", False, True),
        ("contact_hard", True, False),
        ("noise", False, False),
    ):
        with jax.enable_x64(double):
            found = pftwin.simulate(built_scene(case_named(name), "P5"))
        assert bool(found.status & Status.INACCURATE) == flagged, (name, double)


@pytest.mark.slow
def test_a_spike_of_one_frame_in_long_steps_is_said():
    """The largest force is 27.4 N; in steps of 2.5 ms frames have shown 136 and 5,034 N."""
    scene = built_scene(case_named("rig_other_springs_in_2_5_ms"), "P5")
    for name in ("linear_implicit", "linear_implicit_bdf2"):
        found = pftwin.simulate(scene, integrator=method_named(name).integrator, dt=2.5e-3)
        off = np.abs(found.effects["contact"]["force"]) > 27.4 + 5.0
        assert (found.flags[off] & int(Status.INACCURATE)).all()
