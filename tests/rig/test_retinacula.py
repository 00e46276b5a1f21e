"""Ligaments for the virtual rig (synthetic): as stiff and long as published, idle where the patella tracks, and what
they do to one that dislocates.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.dynamics.simulate import simulate
from pftwin.files.scene_file import load_scene
from pftwin.rig.retinacula import REFERENCE_POSITION, REFERENCE_QUATERNION, STRANDS, ligament, with_retinacula


@pytest.mark.parametrize(("name", "stiffness"), [("mpfl", 42.5e3), ("lpfl", 16.0e3)])
def test_together_the_strands_are_as_stiff_as_published(name, stiffness):
    group = ligament(name)
    assert group.stiffness.shape == (STRANDS,)
    assert float(np.sum(group.stiffness / group.slack_length)) == pytest.approx(stiffness, rel=1e-6)


def test_the_mpfl_is_about_as_long_as_published():
    """Some 55 mm (Amis et al. 2003), from the medial epicondyle to the medial border."""
    group = ligament("mpfl")
    assert 0.045 < float(group.slack_length.min()) < float(group.slack_length.max()) < 0.060
    assert np.all(group.insertion.y < 0)
    assert np.all(group.origin.y < 0)
    assert np.all(ligament("lpfl").insertion.y > 0)


def test_a_reference_strain_shortens_the_strands():
    plain, tight = ligament("mpfl"), ligament("mpfl", reference_strain=0.05)
    np.testing.assert_allclose(plain.slack_length, 1.05 * tight.slack_length)
    np.testing.assert_allclose(plain.stiffness / plain.slack_length, tight.stiffness / tight.slack_length)


@pytest.fixture(scope="module")
def tracking():
    return simulate(rig.case(1))


def test_the_reference_pose_is_that_of_case_1_in_full_extension(tracking):
    i = int(np.argmin(tracking.knee.flexion))
    assert np.degrees(tracking.knee.flexion[i]) < 2
    np.testing.assert_allclose(tracking.position[i], REFERENCE_POSITION, atol=4e-4)
    here, there = (Rotation.from_quat(q, scalar_first=True) for q in (tracking.quaternion[i], REFERENCE_QUATERNION))
    assert np.degrees((here.inv() * there).magnitude()) < 1.1


def lengths(result, group) -> np.ndarray:
    """Of the strands over the frames [m]."""
    insertion, origin = np.asarray(group.insertion.array()), np.asarray(group.origin.array())
    turn = Rotation.from_quat(result.quaternion, scalar_first=True).as_matrix()
    return np.linalg.norm(result.position[:, None] + np.einsum("nij,sj->nsi", turn, insertion) - origin, axis=2)


def test_the_mpfl_is_tightest_in_extension_and_slackens_as_the_knee_bends(tracking):
    flexion, strain = np.degrees(tracking.knee.flexion), lengths(tracking, ligament("mpfl"))
    strain = strain / np.asarray(ligament("mpfl").slack_length) - 1
    assert np.abs(strain[flexion < 2]).max() < 0.02
    assert strain[flexion > 30].max() < -0.08


@pytest.mark.slow
def test_a_patella_that_tracks_hardly_feels_them(tracking):
    both = simulate(with_retinacula(rig.case(1)))
    assert np.abs(both.center - tracking.center).max() < 0.5e-3
    assert 0 < max(both.effects[name]["tension"].max() for name in ("mpfl", "lpfl")) < 1.0


@pytest.fixture(scope="module")
def dislocating():
    """Case 2 with ligaments, by their names and the strain in the reference pose."""
    wanted = {"none": ((), 0.0), "lpfl": (("lpfl",), 0.0), "mpfl": (("mpfl",), 0.0), "both": (("mpfl", "lpfl"), 0.0)}
    wanted |= {"lax": (("mpfl",), -0.2), "tight": (("mpfl",), 0.06)}
    return {k: simulate(with_retinacula(rig.case(2), n, reference_strain=e)) for k, (n, e) in wanted.items()}


@pytest.mark.slow
def test_the_mpfl_keeps_case_2_from_dislocating(dislocating):
    """50 mm off without it, 13 mm with it, 10 mm with one 6 % tighter; synthetic rig, motion and springs."""
    farthest = {name: 1e3 * result.shift.max() for name, result in dislocating.items()}
    events = {name: len(result.dislocations().events) for name, result in dislocating.items()}
    assert events == {"none": 1, "lpfl": 1, "mpfl": 0, "both": 0, "lax": 1, "tight": 0}
    expected = {"none": 50.5, "lpfl": 50.5, "mpfl": 13.3, "both": 13.3, "lax": 33.5, "tight": 9.6}
    assert farthest == pytest.approx(expected, abs=1.0)


@pytest.mark.slow
def test_held_it_stays_subluxed_unless_the_ligament_is_tight(dislocating):
    """At the end, 49 deg bent, a slack MPFL lets it rest on the flank; a tight one has let it back."""
    assert 1e3 * dislocating["mpfl"].shift[-1] > 10
    assert 1e3 * dislocating["tight"].shift[-1] < 5


@pytest.mark.slow
def test_their_runs_are_clean(dislocating):
    for result in dislocating.values():
        assert result.equilibrium.residual < 1e-6
        assert np.abs(result.energies.budget_error).max() < 0.006 * np.abs(result.energies.work).max()


def test_what_is_not_there_is_refused():
    with pytest.raises(InputError, match=r"no ligament 'acl' of the rig; expected: mpfl, lpfl"):
        rig.with_retinacula(rig.case(1), ["acl"])
    with pytest.raises(InputError, match=r"reference_strain: found -1; expected: a number above -1"):
        ligament("mpfl", reference_strain=-1)


def test_the_documented_tables_are_the_rigs_ligaments(tmp_path: Path):
    """The scene file's text in the documentation, added to that of case 2."""
    from pftwin.rig.scene_template import write_example

    write_example(tmp_path, 2)
    page = (Path(__file__).resolve().parents[2] / "docs" / "effects.md").read_text()
    (block,) = (b for b in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if 'name = "mpfl"' in b)
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{scene.read_text()}\n{block}")
    loaded = load_scene(scene)
    for name in ("mpfl", "lpfl"):
        ours, theirs = ligament(name), loaded.effect(name)
        for field in ("stiffness", "slack_length", "toe_strain", "damping_time"):
            np.testing.assert_allclose(getattr(theirs, field), getattr(ours, field), rtol=2e-3)
        for end in ("insertion", "origin"):
            np.testing.assert_allclose(getattr(theirs, end).array(), getattr(ours, end).array(), atol=1e-6)
