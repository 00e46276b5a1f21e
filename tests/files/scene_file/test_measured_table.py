"""[measured]: positions, forces, readings and weights of a scene file, at the scene's frames and in its units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c3d_files import write_c3d
from scipy.spatial.transform import Rotation
from toy_scene_files import (
    CLUSTERS,
    LIGHT,
    START,
    changed,
    fixed_poses,
    load,
    markers_of,
    refused,
    tibia_poses,
    write_poses,
)

from pftwin.files.mocap import PoseSeries, write_trc
from pftwin.files.scene_file import load_scene, load_scene_file

MEASURED = """
[measured]
patella = { body = "patella" }
forces = "forces.csv"
contact_force = "contact_N"
tibial_spring_force = "tendon"
"""


def test_measurements_are_in_the_femur_at_the_frames(toy: Path) -> None:
    t = np.arange(81) * 0.005
    rows = [f"{x:.4f},{100 * x + 5},{0.001 * x}" for x in t]
    (toy / "forces.csv").write_text("\n".join(["time_s,contact_N,tendon_kN", *rows]) + "\n")
    femur = "\n[femur]\nfixed = { position_m = [0.1, 0, 0] }\n"
    (toy / "measured.toml").write_text(
        changed("radius_mm = 22", "radius_mm = 22\ncenter_mm = [1, 2, 3]", LIGHT + MEASURED + femur)
    )
    measured = load_scene_file(toy / "measured.toml").measured
    assert load_scene(toy / "measured.toml").measured == measured
    assert measured is not None
    assert measured.times.shape == (41,)
    np.testing.assert_allclose(measured.center[7], np.add(START[0], [0.001 - 0.1, 0.002, 0.003]), atol=1e-12)
    assert measured.contact_force is not None
    assert measured.tibial_spring_force is not None
    np.testing.assert_allclose(measured.contact_force[10], 15, atol=1e-9)
    np.testing.assert_allclose(measured.tibial_spring_force[10], 0.1, atol=1e-9)
    assert measured.femoral_spring_force is None
    (toy / "forces.csv").write_text("\n".join(["time_s,contact_N,tendon_kN", *rows[:40]]) + "\n")
    assert "[measured] forces: forces.csv: forces from 0 s to 0.195 s" in refused(toy, LIGHT + MEASURED)


READINGS = """
[[marker]]
name = "m1"
point_mm = [21, 13, 9]
"""


def test_readings_and_weights_are_at_the_frames_in_the_effects_units(toy: Path) -> None:
    t = np.arange(81) * 0.005
    rows = [f"{x:.4f},{30 + 100 * x},{0.002 * x},{float(x > 0.1)}" for x in t]
    (toy / "forces.csv").write_text("\n".join(["time_s,out_mm,medial_kN,counts", *rows]) + "\n")
    measured = '\n[measured]\npatella = { body = "patella" }\nforces = "forces.csv"\nweights = "counts"\n'
    wanted = 'readings = { "m1.x" = "out_mm", "contact.force_medial" = "medial" }\n'
    text = LIGHT + READINGS + measured + wanted
    scene = load(toy, text)
    seen = scene.measured
    assert seen is not None
    np.testing.assert_allclose(np.asarray(scene.effect("m1").point.array()), [0.021, 0.013, 0.009])  # type: ignore[attr-defined]
    np.testing.assert_allclose(seen.readings["m1.x"][10], 0.04, atol=1e-9)
    np.testing.assert_allclose(seen.readings["contact.force_medial"][10], 0.2, atol=1e-9)
    assert seen.weights is not None
    np.testing.assert_array_equal(seen.weights[[0, 5, 10, 11, 20]], [0, 0, 0, 1, 1])
    message = refused(toy, text.replace('"out_mm"', '"medial"'))
    assert "[measured] readings" in message
    assert "its unit is N" in message
    assert "expected: a unit of m" in message
    assert "no observable 'm1.w'" in refused(toy, text.replace('"m1.x"', '"m1.w"'))
    assert "no column called 'far'" in refused(toy, text.replace('"out_mm"', '"far"'))
    bare = LIGHT + READINGS + measured.replace('forces = "forces.csv"\n', "")
    assert "[measured] weights: a column of no file" in refused(toy, bare)


def test_readings_that_do_not_count_keep_their_frames_from_counting(toy: Path) -> None:
    """At 1 kHz, zero from 52 to 54 ms and weighted so: the frame at 50 ms holds them, as its mean is over 10 ms."""
    t = np.arange(401) * 0.001
    bad = (t > 0.0515) & (t < 0.0545)
    rows = [f"{x:.4f},{30 + 100 * x},{0.0 if out else 0.01},{float(not out)}" for x, out in zip(t, bad, strict=True)]
    (toy / "forces.csv").write_text("\n".join(["time_s,out_mm,medial_kN,counts", *rows]) + "\n")
    measured = '\n[measured]\npatella = { body = "patella" }\nforces = "forces.csv"\nweights = "counts"\n'
    seen = load(toy, LIGHT + READINGS + measured + 'readings = { "contact.force_medial" = "medial" }\n').measured
    assert seen is not None
    assert seen.weights is not None
    assert seen.readings["contact.force_medial"][5] < 9
    np.testing.assert_array_equal(np.flatnonzero(seen.weights < 1), [5])
    assert seen.weights[5] == 0


def test_forces_may_be_channels_of_a_c3d_file(toy: Path) -> None:
    pytest.importorskip("ezc3d", reason="the extra c3d is not installed")
    t = np.arange(410) / 1000
    hum = 20 * np.sin(2 * np.pi * 100 * t + 0.5)
    channels = {
        "Fz": ("N", 5 + 100 * t + hum),
        "tendon": ("kN", 0.001 * t),
        "cell": ("mN/V", t),
        "bare": ("", t),
        "odd": ("parsec", t),
        "cord": ("N", 10 + t),
    }
    write_c3d(toy / "trial.c3d", np.ones((41, 1, 3)), ["A"], channels=channels)
    text = LIGHT + MEASURED.replace("forces.csv", "trial.c3d").replace("contact_N", "Fz")
    measured = load(toy, text).measured
    assert measured is not None
    assert measured.contact_force is not None
    assert measured.tibial_spring_force is not None
    frames = np.arange(41) / 100
    np.testing.assert_allclose(measured.contact_force[1:-1], 5 + 100 * frames[1:-1], atol=1e-4)
    np.testing.assert_allclose(measured.tibial_spring_force, frames, atol=1e-6)
    said = {name: refused(toy, text.replace('"Fz"', f'"{name}"')) for name in ("cell", "bare", "odd", "Fx")}
    assert "trial.c3d, column 'cell': its unit is mN/V; expected: a unit of N" in said["cell"]
    assert "column 'bare': no unit; expected: a unit of N" in said["bare"]
    assert "column 'odd': its unit is parsec; expected: a unit of N" in said["odd"]
    assert "no column called 'Fx'; expected: did you mean 'Fz'?" in said["Fx"]
    write_c3d(toy / "markers.c3d", np.ones((41, 1, 3)), ["A"])
    assert "markers.c3d: the file holds no analog data" in refused(toy, text.replace("trial.c3d", "markers.c3d"))

    muscles = '\n[[prescribed_tension]]\nname = "muscles"\nbody = "femur"\nfile = "trial.c3d"\nlines = ["cord"]\n'
    muscles += "insertion_m = [0.02, 0, 0]\norigin_m = [0.2, 0, 0.03]\n"
    tension, _ = load(toy, LIGHT + muscles).effect("muscles").at(0.1005)  # type: ignore[attr-defined]
    np.testing.assert_allclose(tension, [10.1005], rtol=1e-5)
    assert "'cell': its unit is mN/V; expected: cell_N" in refused(toy, LIGHT + muscles.replace('"cord"', '"cell"'))


def test_frames_of_the_patella_that_are_out_of_line_are_left_out_and_named(toy: Path) -> None:
    tibia = tibia_poses()
    places, turns = np.tile(START[0], (41, 1)), np.tile(START[1], (41, 1))
    upside_down = Rotation.from_quat(turns[0], scalar_first=True) * Rotation.from_rotvec([3.0, 0, 0])
    turns[[4, 20, 21, 22]] = upside_down.as_quat(scalar_first=True)
    write_poses(toy / "poses.csv", {"tibia": tibia, "patella": PoseSeries(tibia.times, places, turns)})
    (toy / "odd.toml").write_text(LIGHT + '\n[measured]\npatella = { body = "patella" }\n')
    loaded = load_scene_file(toy / "odd.toml")
    assert loaded.measured is not None
    assert loaded.measured.quaternion is not None
    missing = np.isnan(loaded.measured.center).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(missing), [4, 20, 21, 22])
    np.testing.assert_array_equal(np.isnan(loaded.measured.quaternion).all(axis=1), missing)
    (note,) = (n for n in loaded.notes if "left out" in n)
    assert "poses.csv" in note
    assert "the patella's frames 5, 21 to 23 of 41 (from 0 s on) left out: it jumps" in note


def test_a_scene_starts_at_the_first_frame_in_which_the_patella_is_in_line(toy: Path) -> None:
    """Also with another recording, and where the file says to start in such a frame."""
    tibia, places = tibia_poses(), np.tile(START[0], (41, 1))
    places[:2] += [0.0, 0.08, 0.0]
    patella = PoseSeries(tibia.times, places, np.tile(START[1], (41, 1)))
    write_poses(toy / "poses.csv", {"tibia": tibia, "patella": patella})
    fixed = "start = { fixed = { position_m = [-0.005, 0.001, 0.05] } }"
    text = changed(fixed, 'start = { body = "patella" }', LIGHT)
    (toy / "odd.toml").write_text(text)
    (toy / "told.toml").write_text(changed("[motion]\n", "[motion]\nstart_time_s = 0.01\n", text))
    write_poses(toy / "other.csv", {"tibia": tibia, "patella": patella})
    write_poses(toy / "poses.csv", {"tibia": tibia, "patella": fixed_poses(tibia, *START)})
    whole = load_scene_file(toy / "odd.toml")
    assert whole.scene.motion.n_frames == 41
    assert not whole.notes
    for file, motion, frames in (("odd", "other", "frames 1 to 2 of 41"), ("told", "poses", "frame 1 of 40")):
        if motion == "poses":
            write_poses(toy / "poses.csv", {"tibia": tibia, "patella": patella})
        loaded = load_scene_file(toy / f"{file}.toml", motion=None if motion == "poses" else toy / "other.csv")
        assert loaded.scene.motion.n_frames == 39
        assert loaded.scene.motion.start_time == pytest.approx(0.02)
        np.testing.assert_allclose(loaded.scene.start.position.array(), START[0], atol=1e-9)
        (note,) = loaded.notes
        assert f"the scene starts at 0.02 s: the patella jumps in {frames}" in note


SKIN = """
[[marker]]
name = "skin"
point_m = [0.02, 0.015, 0.03]

[measured]
markers = { skin = "P 1" }
"""


def skin_file(folder: Path, *, femur: str = "", more: str = "", until: int = 41) -> Path:
    """A scene whose tibia, and the skin over the patella, are seen through markers; P 1 moves along y."""
    tibia = tibia_poses()
    patella = PoseSeries(tibia.times, START[0] + np.outer(tibia.times, [0, 0.1, 0]), np.tile(START[1], (41, 1)))
    named = markers_of({"tibia": tibia, "patella": patella})
    seen = replace(named, names=tuple("P 1" if name == "P1" else name for name in named.names))
    positions = seen.positions.copy()
    positions[:9, seen.names.index("P 1")] = np.nan
    positions[15:30, seen.names.index("P 1")] = np.nan
    write_trc(folder / "skin.trc", seen.with_positions(positions).between(0, 0.01 * (until - 1)))
    text = changed('poses = "poses.csv"', f'markers = "skin.trc"\n{more}', LIGHT + SKIN + femur)
    cluster = ", ".join(f"{name} = {list(place)}" for name, place in CLUSTERS["tibia"].items())
    (folder / "skin.toml").write_text(
        changed('body = "tibia"\n\n[patella]', f"cluster_m = {{ {cluster} }}\n\n[patella]", text)
    )
    return folder / "skin.toml"


def test_markers_on_the_skin_are_measured_without_a_pose(toy: Path) -> None:
    turned = Rotation.from_rotvec([0, np.radians(20), 0])
    quaternion = turned.as_quat(scalar_first=True).tolist()
    femur = f"\n[femur]\nfixed = {{ position_m = [0.1, 0, 0], quaternion_wxyz = {quaternion} }}\n"
    measured = load_scene_file(skin_file(toy, femur=femur)).measured
    assert measured is not None
    assert (measured.skin_markers, measured.quaternion) == (("skin",), None)
    assert np.isnan(measured.center).all()
    found = np.stack([measured.readings[f"skin.{axis}"] for axis in "xyz"], axis=1)
    world = np.add(START[0], CLUSTERS["patella"]["P1"]) + np.outer(0.01 * np.arange(41), [0, 0.1, 0]) - [0.1, 0, 0]
    world[:9], world[15:30] = np.nan, np.nan
    np.testing.assert_allclose(found, turned.inv().apply(world), atol=1e-8)


def test_a_fixed_point_among_markers_on_the_skin_does_not_exchange_them(toy: Path) -> None:
    path = skin_file(toy, more="fixed_points_m = { still = [0.3, 0.2, 0.1] }")
    text = changed('markers = { skin = "P 1" }', 'markers = { still = "still", skin = "P 1" }', path.read_text())
    path.write_text(text + '\n[[marker]]\nname = "still"\npoint_m = [0.02, 0.01, 0.03]\n')
    measured = load_scene_file(path).measured
    assert measured is not None
    np.testing.assert_allclose([measured.readings[f"still.{axis}"][20] for axis in "xyz"], [0.3, 0.2, 0.1])


def test_runs_too_short_for_the_filter_are_left_out_and_named(toy: Path) -> None:
    """Frames 9 to 14 and 30 to 40 are seen; the filter of 12 Hz needs 18, that of 40 Hz ten."""
    loaded = load_scene_file(skin_file(toy, more="cutoff_Hz = 40"))
    assert loaded.measured is not None
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(loaded.measured.readings["skin.x"])), np.arange(30, 41))
    assert "P 1: no frames 16 to 30" in loaded.notes
    assert "P 1: frames 10 to 15 left out, too few for the filter" in loaded.notes
    loaded = load_scene_file(skin_file(toy, more="cutoff_Hz = 40\nstart_time_s = 0.1\nend_time_s = 0.35"))
    assert loaded.measured is not None
    np.testing.assert_allclose(loaded.measured.times[[0, -1]], [0.1, 0.35])
    assert np.isfinite(loaded.measured.readings["skin.x"]).sum() == 6


def test_mistakes_in_markers_on_the_skin_are_named(toy: Path) -> None:
    text = skin_file(toy).read_text()
    for old, new, said in (
        ('"P 1"', '"P 9"', "[measured] markers: skin.trc: no marker called 'P 9'"),
        ("{ skin =", "{ skine =", "[measured] markers: toy: no observable 'skine.x'"),
        ('markers = { skin = "P 1" }', "", "[measured]: neither patella nor markers"),
        (
            'markers = { skin = "P 1" }',
            'markers = { skin = "P 1" }\nreadings = { "skin.x" = "a" }',
            "a column of no file",
        ),
        ('markers = "skin.trc"', 'poses = "poses.csv"', "markers are named, and no file of them"),
    ):
        found = refused(toy, changed(old, new, text))
        assert said in found, found
    (toy / "forces.csv").write_text("time_s,a_m\n" + "\n".join(f"{0.01 * i:.2f},0.1" for i in range(41)) + "\n")
    both = 'markers = { skin = "P 1" }\nforces = "forces.csv"\nreadings = { "skin.x" = "a" }'
    found = refused(toy, changed('markers = { skin = "P 1" }', both, text))
    assert "[measured] readings: skin.x is measured by a marker and in a column" in found


def test_another_recording_takes_the_markers_on_the_skin_with_it(toy: Path) -> None:
    scene = skin_file(toy, more="end_time_s = 0.2")
    (toy / "skin.trc").rename(toy / "other.trc")
    other = load_scene(scene, motion=toy / "other.trc").measured
    assert other is not None
    assert other.times.size == 41
    assert other.skin_markers == ("skin",)


def test_smoothing_takes_no_overshoot_and_no_sign(toy: Path) -> None:
    """A cable that lets go, and a load cell that counts compression as negative."""
    t = np.arange(201) * 0.002
    pull = np.where(t < 0.2, 5.0, 0.0)
    rows = [f"{x:.4f},{-20 - 50 * x},{1e-3 * p}" for x, p in zip(t, pull, strict=True)]
    (toy / "forces.csv").write_text("\n".join(["time_s,contact_N,tendon_kN", *rows]) + "\n")
    (toy / "smooth.toml").write_text(LIGHT + MEASURED + "smoothing_window = 30\n")
    measured = load_scene_file(toy / "smooth.toml").measured
    assert measured is not None
    assert measured.contact_force is not None
    assert measured.tibial_spring_force is not None
    np.testing.assert_allclose(measured.contact_force[5:-5], -20 - 50 * measured.times[5:-5], rtol=0.03)
    assert measured.tibial_spring_force.min() == 0
