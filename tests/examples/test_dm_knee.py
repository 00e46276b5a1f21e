"""The real implant, end to end: examples/dm_knee.py against the recording; and where its button pressed."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from figure_parts import footers
from scipy.spatial.transform import Rotation

import pftwin
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.model.measured import SYNTHETIC
from pftwin.results.button_cap import cap_use, check_cap

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "dm_knee.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("dm_knee_example", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def outcome(example, dm_knee):
    return example.run(dm_knee)


def test_the_patella_follows_the_recorded_one(outcome):
    knee, result, comparison = outcome
    assert result.equilibrium.converged
    assert result.status == pftwin.Status.OK  # every contact on the fitted patch, in every frame
    assert np.degrees(result.knee.flexion[[0, -1]]) == pytest.approx([0, 80], abs=2)
    assert result.times[0] == pytest.approx(0.5)
    assert comparison.mean_distance <= 2.5e-3
    assert np.all(comparison.angle_rms <= [0.5, 3.5, 5.0])
    assert knee.patch.rms < 0.15e-3
    assert knee.sphere.radius == pytest.approx(19.05e-3, abs=5e-6)


def test_results_and_figures_say_that_no_knee_moved_so(outcome):
    """Another code computed the motion: docs/bring_your_own_knee.md."""
    result = outcome[1]
    assert result.to_dataset().attrs["note"] == SYNTHETIC
    figure = result.plot.against_flexion(show=("tilt",), strokes="bending")
    assert SYNTHETIC in " ".join(text.get_text().replace("\n", " ") for text in footers(figure))


@pytest.mark.slow
def test_with_the_meshes_themselves_the_patella_follows_more_closely(example, dm_knee):
    _, result, comparison = example.run(dm_knee, dt=2e-3, contact="mesh")
    assert result.equilibrium.converged
    assert result.status == pftwin.Status.OK
    assert np.degrees(result.knee.flexion[-1]) == pytest.approx(80, abs=2)
    assert comparison.mean_distance <= 1.0e-3  # 1.5 mm wanted
    assert np.all(comparison.angle_rms <= [0.6, 0.9, 3.2])
    simulated, demanded = comparison.force.T
    early = result.times < 1.5
    np.testing.assert_allclose(simulated[early], demanded[early], atol=5, rtol=0.05)


def test_the_recorded_tensions_come_out_at_the_recorded_poses(example, outcome):
    # Pins frames, handedness, strand law and slack lengths independently of the contact: the patellar tendon and the
    # MPFL run straight in the recording. The LPFL wraps there, and straight strands pull less.
    knee, _, _ = outcome
    pulls = example.pulls_at_recorded_poses(knee)
    for kind in ("PT", "MPFL"):
        recorded = knee.tensions.column(example.LIGAMENTS[kind])
        assert recorded.max() > 40
        np.testing.assert_allclose(pulls[kind.lower()][1], recorded, atol=0.15)
    assert np.all(pulls["lpfl"][1] <= knee.tensions.column("lpfl") + 0.1)
    np.testing.assert_allclose(pulls["quadriceps"][1], knee.tensions.column("quadriceps"), rtol=0.02, atol=0.3)
    assert pulls["gravity"][0][0] == pytest.approx([-0.36, 0.0, -4.39], abs=0.02)  # lying on the back


def test_contact_force_and_tendon_tension_are_the_recordings(outcome):
    _, result, comparison = outcome
    assert result.effects["contact"]["force"].min() > 10
    simulated, demanded = comparison.force.T
    early = result.times < 1.5
    np.testing.assert_allclose(simulated[early], demanded[early], atol=5, rtol=0.05)
    assert np.sqrt(np.mean((simulated - demanded) ** 2)) < 40
    assert np.abs(np.diff(comparison.tensions["PT"], axis=1)).max() < 20
    assert "mean distance" in str(comparison)


def test_a_load_beyond_the_buttons_cap_gives_a_warning(outcome):
    knee, result, _ = outcome
    with pytest.warns(PftwinWarning, match=r"DM knee: contact left the button's spherical cap \(3[12] deg"):
        use = check_cap(result, knee.sphere)
    assert 0 < use.load_share < 1
    assert use.frames > 20
    assert not use.beyond[:, 1][result.times < 1.5].any()  # the lateral facet presses within the cap early on


def test_the_gait_trial_becomes_motion(example, dm_knee):
    motion = example.gait_motion(dm_knee)
    assert motion.n_frames == 370
    assert motion.femur is not None


def _on_a_sphere(angles_deg: float | list[float], force: float | list[float] = 10.0) -> Any:
    """A result in which the medial facet presses at angles from the apex -z of a turned patella; lateral: apart."""
    angles = np.radians(np.atleast_1d(angles_deg))
    n = angles.size
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2])
    arms = turn.apply(np.stack([0 * angles, -np.sin(angles), -np.cos(angles)], axis=1)) * 0.019
    center = np.tile([0.01, 0.02, 0.03], (n, 1))
    report = {
        "force_medial": np.broadcast_to(force, n),
        "force_lateral": np.zeros(n),
        "point_medial": center + arms,
        "point_lateral": np.full((n, 3), np.nan),
    }
    quaternion = np.tile(turn.as_quat(scalar_first=True), (n, 1))
    return SimpleNamespace(
        contact="contact", effects={"contact": report}, center=center, quaternion=quaternion, scene_name="toy"
    )


CAP: Any = SimpleNamespace(axis=np.array([0.0, 0.0, -1.0]), cap_half_angle=np.radians(30.0), radius=0.019)


def test_angles_are_counted_from_the_apex_in_the_patellas_frame():
    use = cap_use(_on_a_sphere([0, 10, 29, 31, 50], [10, 10, 10, 10, 60]), CAP)
    assert np.degrees(use.angle[:, 0]) == pytest.approx([0, 10, 29, 31, 50], abs=1e-5)
    assert np.isnan(use.angle[:, 1]).all()
    assert use.beyond[:, 0].tolist() == [False, False, False, True, True]
    assert use.frames == 2
    assert use.load_share == pytest.approx(0.7)
    assert "2 of 5 frames, by up to 20 deg; 70 % of the load" in use.describe()


def test_no_warning_on_the_cap():
    use = check_cap(_on_a_sphere([5, 20]), CAP)  # warnings of pftwin are errors here
    assert use.describe() == "every contact lay on the cap, at most 20 deg of 30 deg from its apex"
    assert cap_use(_on_a_sphere(50, 0.0), CAP).describe() == "the button touched nothing"
    assert cap_use(_on_a_sphere(50, 0.0), CAP).load_share == 0


def test_cap_needs_a_contact_and_an_axis():
    no_axis: Any = SimpleNamespace(axis=np.zeros(3), cap_half_angle=0.5, radius=0.019)
    lonely: Any = SimpleNamespace(contact=None, scene_name="toy")
    with pytest.raises(InputError, match=r"toy: no sphere contact; try: add a SphereContact"):
        cap_use(lonely, CAP)
    with pytest.raises(InputError, match=r"cap.axis: .* is no unit vector"):
        cap_use(_on_a_sphere(5), no_axis)


def test_bad_folders_are_one_message_and_exit_code_2(example, dm_knee, tmp_path, capsys):
    assert example.main([str(tmp_path / "nowhere")]) == 2
    assert "no such folder; try: name the folder" in capsys.readouterr().err
    for name in ("passive_flexion_poses.csv", "femoral_component_contact.stl", "patellar_button_contact.stl"):
        shutil.copy(dm_knee / name, tmp_path)
    for text in ("", "{", "[]", json.dumps({"PT1": {"points": [["patella", [0, 0, 0]]]}})):
        (tmp_path / "ligaments.json").write_text(text)
        assert example.main([str(tmp_path)]) == 2
        assert "ligaments.json: no usable list of strands" in capsys.readouterr().err
