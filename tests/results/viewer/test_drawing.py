"""What is drawn against the result it was drawn from: poses, lines, forces, names; and what is refused."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from itertools import pairwise

import equinox as eqx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scene import small_result
from viewer_pages import both

from pftwin.base.errors import InputError, MissingExtraError, OutputError
from pftwin.files.result_files import load_dataset, save_dataset
from pftwin.results.viewer import view
from pftwin.results.viewer.assembly import plot
from pftwin.results.viewer.page import page
from pftwin.results.viewer.recorded import MOST_FRAMES, Recorded, recorded
from pftwin.results.viewer.shapes import MOST_TRIANGLES, Shape, behind_plane, path, shell, spaced_points, surface, tubes

pytest.importorskip("k3d")


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def file(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "knee.nc"
    result.save(path)
    return path


@pytest.fixture(scope="module")
def drawn(result):
    return view(result)


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    target = tmp_path_factory.mktemp("html") / "view.html"
    view(both(), html=target)
    return target


def named(drawn, name):
    (found,) = [o for o in drawn.objects if o.name == name]
    return found


@pytest.mark.parametrize("name", ["patella (schematic)", "button"])
def test_the_patella_goes_where_the_result_says(drawn, result, name):
    matrices = named(drawn, name).model_matrix
    assert len(matrices) == result.times.size
    for k, t in enumerate(result.times):
        matrix = matrices[f"{t:.4f}"]
        turn = Rotation.from_quat(result.quaternion[k], scalar_first=True).as_matrix()
        np.testing.assert_allclose(matrix[:3, :3], turn, atol=1e-6)
        np.testing.assert_allclose(matrix[:3, 3], 1e3 * result.position[k], atol=1e-4)
        np.testing.assert_array_equal(matrix[3], [0, 0, 0, 1])


@pytest.mark.parametrize("tendon", ["quadriceps", "patellar_tendon"])
def test_lines_are_as_long_as_their_tendons(result, tendon):
    one = Recorded.of(result)
    ends = 1e3 * one.lines[tendon].paths[:, 0]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    np.testing.assert_allclose(length, 1e3 * result.effects[tendon]["length"], atol=1e-3)


def test_tubes_begin_and_end_where_lines_do(drawn, result):
    one = Recorded.of(result)
    ends = 1e3 * one.lines["patellar_tendon"].paths[:, 0]
    for k, vertices in enumerate(named(drawn, "patellar tendon").vertices.values()):
        rings = vertices.reshape(2, -1, 3)
        np.testing.assert_allclose(rings.mean(axis=1), ends[k], atol=1e-3)


def test_forces_on_the_facets_are_the_contact_force(result):
    one = Recorded.of(result)
    total = sum(np.where(arrow.present[:, None], arrow.forces, 0.0) for arrow in one.contact_arrows)
    reported = np.stack([result.effects["contact"][f"force_{a}"] for a in "xyz"], axis=1)
    assert np.abs(reported).max() > 1
    # A contact point is a Newton step from the nearest one: that much the direction to the centre is off.
    np.testing.assert_allclose(total, reported, rtol=0, atol=1e-5 * np.abs(reported).max())


def test_without_a_sphere_one_force_stands_for_both_facets(result):
    one = Recorded.of(result)
    one = dataclasses.replace(one, geometry=one.geometry.drop_vars(["button_center", "button_radius"]))
    medial, lateral, whole = one.contact_arrows
    assert medial.forces is None
    assert lateral.touches
    assert not whole.touches
    contact = result.effects["contact"]
    np.testing.assert_allclose(whole.forces, np.stack([contact[f"force_{a}"] for a in "xyz"], axis=1))
    weights = np.stack([contact["force_medial"], contact["force_lateral"]], axis=1)
    points = np.nan_to_num(np.stack([contact["point_medial"], contact["point_lateral"]], axis=1))
    expected = (weights[..., None] * points).sum(axis=1) / weights.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(whole.points, expected, atol=1e-12)


def test_arrows_are_as_long_as_the_legend_says(drawn, result):
    legend = named(drawn, "legend").text
    newtons = float(re.search(r"10 mm for (\S+)\sN", legend).group(1))
    matrices = named(drawn, "contact, medial: force on the patella").model_matrix
    force = result.effects["contact"]["force_medial"]
    for k in np.flatnonzero(force > 0):
        length = np.linalg.norm(matrices[f"{result.times[k]:.4f}"][:3, 2])
        assert length == pytest.approx(10 * force[k] / newtons, rel=1e-5)


def test_what_bears_nothing_is_hidden(result):
    effects = {n: dict(r) for n, r in result.effects.items()}
    contact = effects["contact"]
    apart_at = np.arange(result.times.size) < 5
    contact["force_medial"] = np.where(apart_at, 0.0, contact["force_medial"])
    contact["point_medial"] = np.where(apart_at[:, None], np.nan, contact["point_medial"])
    drawn = view(dataclasses.replace(result, effects=effects))
    arrow = named(drawn, "contact, medial: force on the patella")
    assert list(arrow.visible.values()) == (~apart_at).tolist()
    assert np.isfinite(np.stack(list(arrow.model_matrix.values()))).all()


def test_the_path_grows_to_the_whole(drawn):
    frames = list(named(drawn, "contact, lateral: path").vertices.values())
    spread = [np.ptp(v, axis=0).max() for v in frames]
    assert spread[0] < 2.0
    assert spread[-1] > 1.5 * spread[0]
    assert all(b >= a - 1e-4 for a, b in pairwise(spread))


def test_a_long_result_is_thinned_from_end_to_end(result):
    few = Recorded.of(result, frames=7)
    assert few.times.size == 7
    assert few.times[[0, -1]] == pytest.approx(result.times[[0, -1]])
    assert few.frames.tolist() == [0, 7, 13, 20, 27, 33, 40]
    assert MOST_FRAMES <= 300


def test_a_file_is_drawn_as_its_result_is(file, drawn):
    from_file = view(file)
    assert from_file.name == "knee"
    for name in ("button", "femoral surface", "quadriceps"):
        one, two = named(from_file, name), named(drawn, name)
        np.testing.assert_allclose(_numbers(one.vertices), _numbers(two.vertices), atol=1e-4)


def _numbers(vertices):
    return np.stack(list(vertices.values())) if isinstance(vertices, dict) else vertices


def test_results_are_overlaid_in_colours_with_the_bones_once():
    drawn, control = plot(recorded(both()))
    names = [o.name for o in drawn.objects]
    assert names.count("femur (schematic)") == names.count("tibia (schematic)") == 1
    assert names.count("button") == 2
    assert [r["name"] for r in control["results"]] == ["before", "after <b>8 mm</b>"]
    assert len({r["colour"] for r in control["results"]}) == 2
    own = [set(r["ids"]) for r in control["results"]]
    assert not own[0] & own[1]


@pytest.mark.parametrize("side_by_side", [False, True])
def test_lateral_and_medial_are_written_beyond_the_patella(result, side_by_side):
    """The patella's bone is 30 mm wide or more; side by side the first knee is 65 mm lateral of the middle."""
    position = result.position.copy()
    position[[5, 30], 1] += [0.06, -0.09]
    drawn = view({"one": dataclasses.replace(result, position=position), "two": result}, side_by_side=side_by_side)
    aside = 65.0 if side_by_side else 0.0
    lateral, medial = (named(drawn, side) for side in ("lateral", "medial"))
    assert lateral.position[1] > 1e3 * position[:, 1].max() + 15 + aside
    assert medial.position[1] < min(1e3 * position[:, 1].min() - 15 + aside, 1e3 * result.position[:, 1].min() - aside)
    assert (lateral.reference_point, medial.reference_point) == ("rc", "lc")  # the words extend away from the knees


def test_a_page_opens_where_a_dislocated_patella_is_farthest(result):
    one = Recorded.of(result)
    offset, out = np.zeros(one.times.size), np.zeros(one.times.size)
    assert plot([one])[1]["opening"] == one.times[0]
    offset[[3, 20, 25]], out[15:30] = [0.05, -0.03, 0.02], 1  # the largest while it is out is in frame 20
    data = one.data.assign(groove_offset=("time", offset), dislocated=("time", out))
    gone = dataclasses.replace(one, name="gone", data=data)
    assert plot([one, gone])[1]["opening"] == pytest.approx(0.20)


def test_a_component_that_was_moved_is_drawn_for_itself(result):
    scene = result.scene
    k = scene.index("contact")
    z = scene.effects[k].surface.chart.origin.z
    moved = eqx.tree_at(lambda s: s.effects[k].surface.chart.origin.z, scene, z + 0.002)
    drawn = view({"before": result, "after": dataclasses.replace(result, scene=moved)})
    before, after = [o for o in drawn.objects if o.name == "femoral surface"]
    np.testing.assert_allclose(after.vertices - before.vertices, [[0, 0, 2]] * len(before.vertices), atol=1e-3)
    assert before.color != after.color


def test_a_surface_goes_on_to_where_any_result_touched_it(result):
    contact = dict(result.effects["contact"])
    contact["point_lateral"] = contact["point_lateral"] + [0.0, 0.02, 0.0]
    out = dataclasses.replace(result, effects={**result.effects, "contact": contact})
    drawn = view({"in": result, "out": out})
    names = [o.name for o in drawn.objects]
    assert names.count("femoral surface") == 1
    assert names.count("surface continued") == 1


def test_equal_names_are_made_unique(file):
    assert [r.name for r in recorded([file, file])] == ["knee (1)", "knee (2)"]


def test_a_scene_of_tendons_alone_is_drawn(result):
    tendons = {n: result.effects[n] for n in ("quadriceps", "patellar_tendon")}
    scene = result.scene.without("contact")
    bare = dataclasses.replace(result, scene=scene, effects=tendons, contact=None, surface=None)
    names = {o.name for o in view(bare).objects}
    assert {"quadriceps", "patellar tendon", "patella (schematic)", "tibia (schematic)"} <= names
    assert not {"button", "femoral surface"} & names


def test_is_a_notebook_s_widget(drawn):
    assert "application/vnd.jupyter.widget-view+json" in drawn._repr_mimebundle_()[0]
    assert drawn.get_time_series_range() == [0.0, pytest.approx(0.4)]


def test_synthetic_data_are_called_so(result):
    quiet = named(view(result), "legend").text
    assert "synthetic" not in quiet
    assert "schematic" in quiet
    made_up = dataclasses.replace(result, scene=dataclasses.replace(result.scene, synthetic=True))
    assert "synthetic" in named(view(made_up), "legend").text


def test_the_page_is_small_whole_and_asks_for_nothing(html):
    text = html.read_text(encoding="utf-8")
    assert html.stat().st_size < 8e6
    assert "<title>before and after &lt;b&gt;8 mm&lt;/b&gt;</title>" in text
    own = re.sub(r"<script id='(?:fflatejs|requirejs)'>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"""(?:src|href)\s*=|@import|url\(|\bfetch\(|https?://""", own)


def test_a_name_cannot_end_the_script(result):
    name = "</script><script>window.bad = true</script>"
    text = page(view({name: result}))
    assert name not in text
    assert json.loads(re.search(r'\{"begin".*\}(?=\)\);)', text).group(0))["results"][0]["name"] == name


def test_old_files_say_what_to_do(result, tmp_path):
    save_dataset(result.to_dataset(), tmp_path / "old.nc")
    assert "time" in load_dataset(tmp_path / "old.nc").dims  # still a result
    with pytest.raises(InputError, match=r"old\.nc: holds no group 'geometry'.*simulate again"):
        view(tmp_path / "old.nc")


def test_what_is_no_result_is_refused(result, tmp_path):
    save_dataset(result.geometry(), tmp_path / "other.nc")
    with pytest.raises(InputError, match="no motion of a patella"):
        view(tmp_path / "other.nc")
    with pytest.raises(InputError, match="no such file"):
        view(tmp_path / "absent.nc")
    with pytest.raises(InputError, match="hidden: no result after; expected: some of: small knee"):
        view(result, hidden=["after"])
    with pytest.raises(InputError, match="nothing to draw"):
        view([])
    lost = dataclasses.replace(result, position=np.full_like(result.position, np.nan))
    with pytest.raises(InputError, match="0 frames with finite poses"):
        view(lost)


def test_frames_that_are_not_finite_are_left_out(result):
    position = result.position.copy()
    position[30:] = np.nan
    drawn = view(dataclasses.replace(result, position=position))
    assert len(named(drawn, "button").model_matrix) == 30


def test_a_place_that_cannot_be_written_to_is_refused(result, tmp_path):
    with pytest.raises(OutputError, match="there is no folder"):
        view(result, html=tmp_path / "absent" / "view.html")


def test_without_k3d_the_extra_is_named(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "k3d", None)
    with pytest.raises(MissingExtraError, match=r"pftwin\[viewer\]"):
        view(result)


def test_importing_the_viewer_does_not_import_k3d():
    code = (
        "import sys, pftwin.results.viewer, pftwin.cli.exchange; "
        "print([m for m in ('k3d', 'jax', 'trimesh') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[]"


def test_tubes_and_paths_keep_their_radius():
    ends = np.array([[[0.0, 0, 0], [1, 2, 3]], [[0, 0, 1], [1, 2, 3]]])
    vertices, triangles = tubes(ends[:, None], 0.5, 8)
    rings = vertices.reshape(2, 2, 8, 3)
    assert np.linalg.norm(rings - ends[:, :, None], axis=-1) == pytest.approx(0.5, rel=1e-5)
    assert triangles.max() == 15
    points = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan] * 3, [5, 0, 0], [6, 1, 0]])
    drawn = path(points, 0.3, sides=4)
    assert len(drawn.vertices) == 4 * 4
    assert len(drawn.triangles) == 2 * 4 * 2  # the gap stays open
    assert spaced_points(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.5, 0, 0]]), 0.4).tolist() == [True, False, True]


def test_a_shell_is_closed_and_its_top_is_the_surface(result):
    from trimesh import Trimesh

    component = Recorded.of(result).mesh("surface")
    made = shell(component, 5.0)
    solid = Trimesh(made.vertices, made.triangles)
    assert solid.is_watertight
    assert solid.volume > 0
    np.testing.assert_allclose(made.vertices[: len(component[0])], 1e3 * component[0], atol=1e-4)


def test_of_a_ball_what_faces_the_femur_is_drawn():
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=3, radius=0.02)
    whole = surface((np.asarray(ball.vertices), np.asarray(ball.faces)))
    cap = behind_plane(whole, -9.0)
    assert cap.vertices[cap.triangles].mean(axis=1)[:, 2].max() <= -9.0
    assert 0.2 < len(cap.triangles) / len(whole.triangles) < 0.35
    assert behind_plane(whole, -30.0) is whole


def test_large_meshes_get_fewer_triangles_and_stay_where_they_are():
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=6, radius=0.02)
    assert len(ball.faces) > MOST_TRIANGLES
    drawn: Shape = surface((np.asarray(ball.vertices), np.asarray(ball.faces)))
    assert len(drawn.triangles) <= MOST_TRIANGLES
    assert np.linalg.norm(drawn.vertices, axis=1) == pytest.approx(20.0, abs=0.02)
