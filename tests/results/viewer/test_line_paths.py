"""Lines of force are drawn as they run: round what they wrap over, from a result or from its file."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scene import small_result
from wrapped_scene import BESIDE, RADII, ROUND, wrapped_result

from pftwin.results.viewer.recorded import Recorded

pytestmark = pytest.mark.slow  # the scene compiles for long; tests/geometry/test_arcs.py has the arcs themselves


@pytest.fixture(scope="module")
def result():
    return wrapped_result()


@pytest.fixture(scope="module")
def drawn(result, tmp_path_factory) -> Recorded:
    path = tmp_path_factory.mktemp("result") / "knee.nc"
    result.save(path)
    return Recorded.of(path)


def local(result, body: str, points: np.ndarray) -> np.ndarray:
    """Points of the femur's frame (n, ..., 3) in a body's frame."""
    if body == "femur":
        return points
    position, quaternion = {"patella": (result.position, result.quaternion), "tibia": result.tibia}[body]
    turns = Rotation.from_quat(quaternion, scalar_first=True)
    seen = [turn.inv().apply((p - at).reshape(-1, 3)) for turn, p, at in zip(turns, points, position, strict=True)]
    return np.array(seen).reshape(points.shape)


def between(paths: np.ndarray) -> np.ndarray:
    """All points of lines (n, k, m, 3) and some of the chords between them."""
    share = np.linspace(0, 1, 11)[:, None, None]
    return np.concatenate([(1 - s) * paths[:, :, :-1] + s * paths[:, :, 1:] for s in share], axis=2)


@pytest.mark.parametrize("name", ["quadriceps", "patellar_tendon", "brace", "mpfl"])
def test_lines_reach_from_insertion_to_origin(result, drawn, name):
    paths, line = drawn.lines[name].paths, result.scene.effect(name)
    first, last = (np.atleast_2d(np.asarray(p.array())) for p in (line.insertion, line.origin))
    assert paths.shape == (result.times.size, len(first), 10, 3)
    for body, end, at in (("patella", first, paths[:, :, 0]), (line.body, last, paths[:, :, -1])):
        np.testing.assert_allclose(local(result, body, at), np.broadcast_to(end, at.shape), atol=1e-12)


@pytest.mark.parametrize("name", ROUND)
def test_lines_are_as_long_as_the_simulation_says(result, drawn, name):
    """But for chords in place of the arc, and single precision."""
    paths = drawn.lines[name].paths[:, 0]
    drawn_length = np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)
    length = result.effects[name]["length"]
    np.testing.assert_allclose(drawn_length, length, atol=2e-7)
    if name != "quadriceps":  # which hardly bends
        assert (length - np.linalg.norm(paths[:, -1] - paths[:, 0], axis=1)).max() > 1e-4


@pytest.mark.parametrize(("name", "bone", "radius"), [(n, *r) for n, r in ROUND.items()])
def test_lines_go_round_cylinders_on_every_bone(result, drawn, name, bone, radius):
    """Their axes are the bones' y."""
    obstacle = result.scene.effect(name).wrap
    points = local(result, bone, between(drawn.lines[name].paths))
    away = np.hypot(points[..., 0] - float(obstacle.center.x), points[..., 2] - float(obstacle.center.z))
    assert away.min() > 0.999 * radius
    assert away.min() < radius


def test_strands_go_round_an_ellipsoid(drawn):
    points = between(drawn.lines["mpfl"].paths)
    away = np.linalg.norm((points - BESIDE) / RADII, axis=-1)
    assert away.min() > 0.995
    straight = between(drawn.lines["mpfl"].paths[:, :, [0, -1]])
    assert np.linalg.norm((straight - BESIDE) / RADII, axis=-1).min() < 0.8


def test_a_line_that_lifts_off_is_straight_there(result, drawn):
    """Its points then divide it evenly."""
    clear = np.isnan(drawn.geometry["quadriceps_arc"]).all(axis=(1, 2, 3)).values
    assert 0 < clear.sum() < clear.size
    paths = drawn.lines["quadriceps"].paths[clear, 0]
    even = np.linspace(paths[:, 0], paths[:, -1], 10, axis=1)
    np.testing.assert_allclose(paths, even, atol=1e-15)


def test_a_line_that_never_touches_is_two_points(result):
    """As are lines without an obstacle, and all in files of older versions, which lack arcs."""
    tendon = result.scene.effect("patellar_tendon")
    away = eqx.tree_at(lambda t: t.wrap.center.x, tendon, tendon.wrap.center.x + 1.0)
    one = Recorded.of(dataclasses.replace(result, scene=result.scene.with_effect(away)))
    assert "patellar_tendon_arc" not in one.geometry
    assert one.lines["patellar_tendon"].paths.shape[2] == 2
    assert one.lines["mpfl"].paths.shape[2] == 10
    old = dataclasses.replace(one, geometry=one.geometry.drop_vars("mpfl_arc"))
    np.testing.assert_array_equal(old.lines["mpfl"].paths, one.lines["mpfl"].paths[:, :, [0, -1]])
    plain = Recorded.of(small_result())
    assert not [name for name in plain.geometry if str(name).endswith("_arc")]
    assert {lines.paths.shape[2] for lines in plain.lines.values()} == {2}


def test_frames_left_out_leave_out_their_arcs(result, drawn):
    few = Recorded.of(result, frames=5)
    np.testing.assert_allclose(few.lines["mpfl"].paths, drawn.lines["mpfl"].paths[::10], atol=1e-9)
