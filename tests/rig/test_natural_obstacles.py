"""Ligaments and vasti of the natural knee (synthetic) wrap over its femur as strings pulled taut over it do."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pftwin import rig
from pftwin.base.leaves import vector
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.implicit import gradient
from pftwin.geometry.bones.tibiofemoral import FemurShape
from pftwin.results.scene_geometry import ON_ARC
from pftwin.rig.natural import placing
from pftwin.rig.natural.obstacles import beside_condyle, over_trochlea

KNEES = {"normal": Anatomy(), **{kind: Anatomy.dejour(kind) for kind in "ABCD"}}


def strings(body: FemurShape, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Lengths (n,) of chains between points (n, 3) that contract outside a body [mm].

    Of 8 parts, then of 16 and of 32: long bends even out while there are few parts. Four thousand rounds with all of
    them change the lengths by 0.002 mm.
    """
    at = start[:, None] + np.linspace(0, 1, 9)[:, None] * (end - start)[:, None]
    for parts in (8, 16, 32):
        if at.shape[1] != parts + 1:
            at = np.insert(at, np.arange(1, at.shape[1]), 0.5 * (at[:, 1:] + at[:, :-1]), axis=1)
        for _ in range(60):
            inner = 0.5 * (at[:, :-2] + at[:, 2:]).reshape(-1, 3)
            value, slope = body(inner), gradient(body, inner)
            out = (np.maximum(value, 0) / np.maximum((slope**2).sum(axis=1), 1e-9))[:, None] * -slope
            size = np.linalg.norm(out, axis=1, keepdims=True)
            inner = inner + out * np.minimum(1, 1 / np.maximum(size, 1e-9))
            at[:, 1:-1] = inner.reshape(len(start), -1, 3)
    return np.linalg.norm(np.diff(at, axis=1), axis=2).sum(axis=1)


def depths(body: FemurShape, points: np.ndarray) -> np.ndarray:
    """Distances from points (..., 3) inside a body to points of its surface near them; 0 outside [mm]."""
    points = points.reshape(-1, 3)
    inside = points[body(points) > 0]
    at = inside
    for _ in range(6):
        slope = gradient(body, at)
        at = at - (body(at) / (slope**2).sum(axis=1))[:, None] * slope
    np.testing.assert_allclose(body(at), 0, atol=1e-6)
    return np.array([0.0, *np.linalg.norm(at - inside, axis=1)])


@jax.jit
def depths_and_length(obstacle, start, end):
    return obstacle.depth(start), obstacle.depth(end), obstacle.around(start, end).length


def lengths(obstacle, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Of taut lines around an obstacle [mm]; their ends are outside it."""
    first, last, length = map(np.asarray, depths_and_length(obstacle, *(vector(1e-3 * p) for p in (start, end))))
    assert np.all(first < 0)
    assert np.all(last < 0)
    return 1e3 * length


@pytest.mark.parametrize("name", ["mpfl", "lpfl"])
@pytest.mark.parametrize("anatomy", KNEES.values(), ids=KNEES)
def test_ligaments_are_as_long_as_strings_over_the_bone(anatomy, name):
    """Straight ones are shorter by up to 2.5 mm."""
    ends = placing.retinaculum(anatomy, name)
    poses = [placing.rest_pose(anatomy, flexion) for flexion in (0.0, 30.0, 60.0, 90.0)]
    start = np.concatenate([place + turn.apply(ends.patella) for place, turn in poses])
    end = np.tile(ends.body, (len(poses), 1))
    length = lengths(beside_condyle(anatomy, placing.SIDES[name]), start, end)
    np.testing.assert_allclose(length, strings(FemurShape(anatomy), start, end), atol=0.6)


@pytest.mark.parametrize("name", ["mpfl", "lpfl"])
def test_ligaments_are_drawn_over_the_bone(name):
    """Of the normal knee, with the chords between the points; straight they are 3 to 7 mm in it."""
    normal = KNEES["normal"]
    ends, body = placing.retinaculum(normal, name), FemurShape(normal)
    poses = [placing.rest_pose(normal, flexion) for flexion in (0.0, 30.0, 60.0, 90.0)]
    start = np.concatenate([place + turn.apply(ends.patella) for place, turn in poses])
    end = np.tile(ends.body, (len(poses), 1))
    arc = beside_condyle(normal, placing.SIDES[name]).arc(vector(1e-3 * start), vector(1e-3 * end), ON_ARC)
    straight, bent = np.linspace(start, end, ON_ARC + 2), 1e3 * np.asarray(arc.array())
    path = np.concatenate([start[None], np.where(np.isnan(bent), straight[1:-1], bent), end[None]])
    deepest = [
        depths(body, np.concatenate([(1 - s) * line[:-1] + s * line[1:] for s in np.linspace(0, 1, 9)])).max()
        for line in (path, straight)
    ]
    assert deepest[0] < 1.0
    assert deepest[1] > 3.0


@pytest.mark.parametrize("name", KNEES)
def test_the_vasti_of_a_bent_knee_are_as_long_as_strings_over_the_trochlea(name):
    """With the patella 75 deg down the groove, to points before the shaft; straight ones lack up to 0.7 mm."""
    anatomy = KNEES[name]
    angle, radius = np.radians(-75.0), anatomy.trochlear_radius_mm
    place, turn = radius * np.array([np.sin(angle), 0.0, np.cos(angle)]), Rotation.from_euler("Y", angle)
    start = place + turn.apply(placing.muscles(anatomy).patella)
    end = start * [0, 1, 0] + [40.0, 0.0, 27.0]
    length = lengths(over_trochlea(anatomy), start, end)
    assert np.all((length - np.linalg.norm(end - start, axis=1))[:2] > 0)  # medialis and lateralis wrap
    np.testing.assert_allclose(length, strings(FemurShape(anatomy), start, end), atol=0.05)


@pytest.mark.slow
def test_ligaments_are_just_slack_on_their_way_over_the_bone_in_full_extension():
    normal = KNEES["normal"]
    scene = rig.knee(normal, duration=0.5, resolution_mm=2.0)
    place, turn = placing.rest_pose(normal, 0.0)
    for name in ("mpfl", "lpfl"):
        ends = placing.retinaculum(normal, name)
        taut = strings(FemurShape(normal), place + turn.apply(ends.patella), ends.body)
        np.testing.assert_allclose(1e3 * np.asarray(scene.get(f"{name}.slack_length")), taut, atol=0.4)
    for name in ("mpfl", "lpfl", "quadriceps"):
        line = scene.effect(name).line_element()
        assert line is not None
        assert line.wrap is not None
