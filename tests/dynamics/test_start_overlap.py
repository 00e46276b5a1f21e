"""Surfaces that overlap where the patella was recorded: a reason of a far equilibrium, else a remark."""

from __future__ import annotations

import dataclasses

import pytest
from pressed_button import disc, pressed
from scenes import J, contact, flat_patch, knee, vec

from pftwin import simulate
from pftwin.base.spatial import Pose, Quaternion
from pftwin.dynamics.equilibrium_report import Start, invalid_start, start_overlap
from pftwin.model.effects.contact_law import Flores
from pftwin.model.scene import Scene

FAR = "the equilibrium is 20.0 mm from the recorded start (at most 10: most_start_shift_mm)"


def ball_at(height: float) -> Scene:
    """A ball of 22 mm radius, its middle so high above a plane."""
    scene = knee().with_effect(contact(Flores(J(2e8), J(0.6)), flat_patch()))
    return dataclasses.replace(scene, start=Pose(vec(0.001, 0.002, height), Quaternion.identity()))


def reasons(scene: Scene, moved: float = 0.02) -> tuple[str, ...]:
    return invalid_start(scene.with_limits(least_upward_lines=0), Start(True, moved, 0.0))


@pytest.mark.parametrize(("height", "overlap"), [(0.019, "3.0"), (0.0209, "1.1"), (0.0211, None), (0.03, None)])
def test_an_overlap_of_more_than_a_millimetre_is_named(height, overlap):
    said = () if overlap is None else (f"the surfaces in contact overlap by {overlap} mm at the recorded start",)
    assert reasons(ball_at(height)) == (FAR, *said)


def test_where_the_equilibrium_is_near_nothing_is_evaluated(monkeypatch):
    monkeypatch.setattr("pftwin.dynamics.equilibrium_report._observe_at", None)
    assert reasons(ball_at(0.019), moved=0.009) == ()


def test_nor_for_one_of_many_draws(monkeypatch):
    scene, far = ball_at(0.019).with_limits(least_upward_lines=0), Start(True, 0.02, 0.0)
    monkeypatch.setattr("pftwin.dynamics.equilibrium_report._observe_at", None)
    assert invalid_start(scene, far, explained=False) == (FAR,)


@pytest.mark.parametrize(
    ("height", "overlap"), [(-0.002, "2.0 mm"), (-0.02, "more than the contact search can measure")]
)
def test_overlapping_cartilage_is_named(height, overlap):
    """Depths are of triangles: the dome's lowest reach 0.004 mm less deep than its apex."""
    said = f"the surfaces in contact overlap by {overlap} at the recorded start"
    assert reasons(pressed(disc(40.0), height, n_frames=11)) == (FAR, said)


def plain_limits(scene: Scene) -> Scene:
    return scene.with_limits(least_upward_lines=0)


@pytest.mark.parametrize(("height", "overlap"), [(-0.002, "2.0 mm"), (-0.0005, None)])
def test_meshes_that_overlap_are_a_remark_where_the_equilibrium_is_near(height, overlap):
    """A motion from there is valid, but its recorded poses and meshes do not belong together."""
    said = "" if overlap is None else f"the surfaces in contact overlap by {overlap} at the recorded start"
    result = simulate(plain_limits(pressed(disc(40.0), height, n_frames=11)))
    assert result.equilibrium.moved < 0.01
    assert result.verdict.valid
    assert result.start_overlap == said
    assert result.summary().splitlines()[-1].startswith("remark: the surfaces") == bool(said)
    assert (f"remark: {said}" in result.summary()) == bool(said)


def test_a_reason_is_not_repeated_as_a_remark():
    limits = {"least_upward_lines": 0, "most_start_shift_mm": 0.1}
    scene = pressed(disc(40.0), -0.002, n_frames=11).with_limits(**limits)
    assert simulate(scene).summary().count("overlap by 2.0 mm at the recorded start") == 1


def test_patches_and_scenes_without_limits_have_no_such_remark(monkeypatch):
    monkeypatch.setattr("pftwin.dynamics.equilibrium_report._observe_at", None)
    assert start_overlap(plain_limits(ball_at(0.019))) == ""
    assert start_overlap(pressed(disc(40.0), -0.002)) == ""
