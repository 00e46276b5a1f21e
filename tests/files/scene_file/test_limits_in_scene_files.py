"""Scene files are of knees: what none can be is refused when they are read, with the line, and can be allowed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from seen_clusters import FOUR, clusters, seen, tibia_seen
from toy_scene_files import CLUSTERS, LIGHT, changed, load, refused
from typer.testing import CliRunner

from pftwin.base.errors import InputError
from pftwin.cli import app
from pftwin.files.mocap import MarkerTrajectories, segment_poses
from pftwin.files.scene_file import load_scene, load_scene_file
from pftwin.files.scene_file.clusters import ClusterFits
from pftwin.model.limits import Limits

HEAVY = changed("mass_kg = 0.12", "mass_kg = 120")


def test_a_patella_of_120_kg_is_refused_and_can_be_allowed_in_three_ways(toy):
    assert "toy: the patella's mass is 120 kg; expected: at most 1 kg" in refused(toy, HEAVY)
    allowed = HEAVY.replace("limits = {", "limits = { most_mass_kg = 121, least_gyration_mm = 0.1,")
    assert float(load(toy, allowed).patella.mass) == 120
    file = toy / "heavy.toml"
    file.write_text(HEAVY)
    scene = load_scene(file, limits={"most_mass_kg": 121, "least_gyration_mm": 0.1})
    assert scene.limits.most_start_turn_deg == 30  # the file's own stay
    allow = ("--allow", "most_mass_kg=121", "--allow", "least_gyration_mm=0.1")
    # Allowed, it is looked at: springs of so few newtons find no equilibrium with 1.2 kN.
    for options, code in (((), 2), (allow, 3), (("--allow", "most_mass_kg"), 2), (("--allow", "most=1"), 2)):
        done = CliRunner().invoke(app, [*options, "equilibrium", str(file), "--json", "-"])
        assert done.exit_code == code, done.output


def test_a_limit_that_is_none_is_named_with_its_line(toy):
    said = refused(toy, changed("limits = {", "limits = { most_weight = 1,"))
    assert "line 1, [limits]: no limit 'most_weight'; expected: one of: least_mass_kg" in said


def test_a_scene_without_tendons_is_refused(toy):
    text = LIGHT[: LIGHT.index("[[tendon]]")] + LIGHT[LIGHT.index("[contact]") :]
    assert "number of lines of force (tendons, ligaments, muscles) is 0" in refused(toy, text)


def test_good_clusters_are_read_and_those_in_a_plane_are_said_to_tell_no_side(toy):
    file = toy / "seen.toml"
    file.write_text(tibia_seen(seen(1e-4), toy, clusters()))
    notes = load_scene_file(file).notes
    assert [n for n in notes if "one plane" in n] == [
        "patella.start: markers in one plane do not tell a left cluster from a right one"
    ]


def test_a_swapped_pair_of_markers_is_refused(toy):
    swapped = {**FOUR, "T1": FOUR["T2"], "T2": FOUR["T1"]}
    said = refused(toy, tibia_seen(seen(), toy, clusters(swapped)))
    assert "[tibia] cluster_m: markers fit a rigid body within" in said
    assert "names swapped? With T1 and T2 exchanged they fit within 0.00 mm;" in said
    assert "(most_marker_residual_mm)" in said
    text = tibia_seen(seen(), toy, clusters(swapped))
    wide = {"most_marker_residual_mm": 100, "most_marker_residual_ratio": 1e9, "least_flexion_deg": -180}
    file = toy / "swapped.toml"
    file.write_text(text)
    load_scene(file, limits={**wide, "most_adduction_deg": 180, "most_rotation_deg": 180, "most_slack_share": 9})


def test_a_swapped_pair_of_a_nearly_regular_cluster_is_named_within_the_limits():
    """The sides of the patella's triangle are 56, 62 and 64 mm: with two markers exchanged 2 mm rms remain."""
    places = {"PAT1": (0.032, 0.004, 0.024), "PAT2": (-0.016, 0.033, 0.022), "PAT3": (-0.018, -0.031, 0.026)}
    swapped = {**places, "PAT1": places["PAT2"], "PAT2": places["PAT1"]}
    off = {**places, "PAT3": (-0.018, -0.036, 0.026)}  # one place is wrong by 5 mm: no exchange explains that
    random = np.random.default_rng(0)
    exact = np.tile(np.array([*places.values()]), (101, 1, 1))
    for cluster, noise, named in (
        (places, 2e-4, False),
        (places, 1e-3, False),
        (off, 2e-4, False),
        (swapped, 2e-4, True),
    ):
        points = exact + noise * random.normal(size=exact.shape)
        markers = MarkerTrajectories(0.01 * np.arange(101), tuple(places), points)
        ClusterFits(Limits(), notes := []).take("patella.start", cluster, markers, segment_poses(markers, cluster))
        assert ("names swapped? With PAT1 and PAT2 exchanged they fit within 0." in notes[0]) == named


def test_a_cluster_that_fits_far_worse_than_the_others_is_refused(toy):
    off = {**FOUR, "T4": (-0.2, 0.0, 0.155)}  # one marker misplaced by 5 mm: 2 mm rms
    said = refused(toy, tibia_seen(seen(5e-5), toy, clusters(off)))
    assert "times the other clusters'" in said
    assert "(most_marker_residual_ratio)" in said
    load(toy, tibia_seen(seen(1e-3), toy, clusters(off)))  # the others are no better


def test_a_cluster_of_the_other_side_is_refused_where_its_markers_tell(toy):
    mirrored = {n: (x, -y, z) for n, (x, y, z) in FOUR.items()}
    said = refused(toy, tibia_seen(seen(), toy, clusters(mirrored)))
    assert "mm rms, and its mirror image within 0.0 mm" in said
    assert "this side of the body" in said


def test_a_side_that_nothing_tells_is_said_to_be_taken_as_given(toy):
    """Of a left knee without clusters, and where all clusters are flat; not of a right one that nothing doubts."""
    file = toy / "side.toml"
    for text, side in (
        (LIGHT, ""),
        (changed("schema = 1", 'schema = 1\nside = "left"'), "left"),
        (tibia_seen(seen(), toy, clusters()), ""),  # one cluster tells
        (tibia_seen(seen(), toy, CLUSTERS), "right"),
    ):
        file.write_text(text)
        found = load_scene_file(file)
        said = f'side = "{side}" is taken as given: nothing in the files tells a left knee from a right one'
        assert found.side_as_given == (said if side else "")
        assert (said in found.notes) == bool(side)


def test_a_frame_turned_by_180_deg_is_refused(toy):
    markers = seen()
    points = markers.positions.copy()
    middle = points[20].mean(axis=0)
    points[20] = middle + Rotation.from_rotvec([np.pi, 0, 0]).apply(points[20] - middle)
    turned = MarkerTrajectories(markers.times, markers.names, points)
    assert "the knee's angular speed after 0.200 s is 314.2 rad/s" in refused(toy, tibia_seen(turned, toy, clusters()))


def test_an_unknown_limit_in_python(toy):
    with pytest.raises(InputError, match="no limit 'heaviest'"):
        load_scene(toy / "scene.toml", limits={"heaviest": 3})
