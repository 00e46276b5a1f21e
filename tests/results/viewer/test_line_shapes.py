"""Ribbons and tubes as which tendons are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.results.viewer.shapes import line_shape, ribbon, tubes


class Strands:
    """Lines of force in two frames, in the order in which an effect has them [m]."""

    radius = 0.55e-3

    def __init__(self, insertion: np.ndarray, origin: np.ndarray) -> None:
        self.insertion = insertion
        self.paths = np.stack([np.stack([insertion + by, origin], axis=1) for by in ([0, 0, 0], [0.001, 0.0, 0.002])])


def fan(gap: float) -> Strands:
    across = gap * np.array([0.0, 2.0, 1.0, 3.0])  # not in order
    insertion = np.stack([0 * across, across, 0 * across + 0.02], axis=1)
    return Strands(insertion, insertion * [1.0, 0.5, 1.0] - [0.06, 0.0, 0.01])


def closed(vertices: np.ndarray, triangles: np.ndarray):
    from trimesh import Trimesh

    made = Trimesh(vertices, triangles, process=False)
    assert made.is_watertight
    assert made.is_winding_consistent
    return made


def test_a_flat_ribbon_is_a_plate():
    across, length = np.array([0.0, 5.0, 9.0]), 30.0
    first = np.stack([0 * across, across, 0 * across], axis=1)
    plate = np.stack([first, np.add(first, [0, 0, length])], axis=1)
    frames = np.stack([plate, plate + 7.0])
    vertices, triangles = ribbon(frames, 2.0)
    for k in range(2):
        plate = closed(vertices[k], triangles)
        assert plate.volume == pytest.approx(9.0 * length * 2.0, rel=1e-5)  # outward: positive
        np.testing.assert_allclose(plate.centroid, [7 * k, 4.5 + 7 * k, 15 + 7 * k], atol=1e-4)


def test_strands_side_by_side_are_one_ribbon_in_their_order_across():
    strands = fan(0.006)
    vertices, triangles = line_shape(strands.paths, strands.radius)
    assert closed(vertices[0], triangles).volume > 0
    middles = vertices.reshape(2, 4, 4, 3)[:, :, [0, 3]].mean(axis=2)  # of either side of each strand, at its insertion
    order = np.argsort(middles[0, :, 1])
    assert order.tolist() in ([0, 1, 2, 3], [3, 2, 1, 0])
    np.testing.assert_allclose(middles[:, order], 1e3 * np.sort(strands.paths[:, :, 0], axis=1), atol=1e-3)


@pytest.mark.parametrize("strands", [fan(0.013), Strands(np.eye(3)[:2] * 0.005, np.eye(3)[:2] * 0.05)])
def test_separate_muscles_and_pairs_are_tubes(strands):
    expected = tubes(1e3 * strands.paths, 0.55, 10)
    for one, other in zip(line_shape(strands.paths, strands.radius), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def bend(across: np.ndarray, points: int = 41) -> np.ndarray:
    """Lines that go straight for 20 mm, a quarter round a radius of 20 mm, and straight for 20 mm again, in a plane."""
    angle = np.linspace(0, np.pi / 2, points)
    arc = 20 * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    line = np.concatenate([[[20, 0, -20]], arc, [[-20, 0, 20]]])
    return np.stack([np.add(line, [0, y, 0]) for y in across])[None]


def test_bent_lines_are_a_bent_ribbon_and_bent_tubes():
    """Of the volumes of bars of their length."""
    length = 40 + 10 * np.pi
    vertices, triangles = ribbon(bend(np.array([0.0, 5.0, 9.0])), 2.0)
    assert closed(vertices[0], triangles).volume == pytest.approx(9 * length * 2, rel=1e-3)
    for k, shape in enumerate(
        [bend(np.array([0.0])), bend(np.array([3.0]))[..., [2, 0, 1]], bend(np.zeros(1))[..., [1, 2, 0]]]
    ):
        vertices, _ = tubes(shape, 1.0, 12)
        rings = vertices.reshape(43, 12, 3)
        np.testing.assert_allclose(rings.mean(axis=1), shape[0, 0], atol=1e-4, err_msg=str(k))
        np.testing.assert_allclose(np.linalg.norm(rings - shape[0, 0][:, None], axis=2), 1.0, atol=1e-5)
        # The sides run along the tube: no ring is turned against its neighbour.
        strips = np.linalg.norm(np.diff(rings, axis=0), axis=2)[1:-1]
        assert strips.max() < np.pi / 2 * 21 / 40 + 1e-3
