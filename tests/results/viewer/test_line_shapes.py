"""Ribbons and tubes as which tendons are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from pftwin.results.viewer.line_shapes import line_shape, ribbon
from pftwin.results.viewer.shapes import tubes


class Strands:
    """Lines of force in two frames, in the order in which an effect has them [m]."""

    radius = 0.55e-3

    def __init__(self, insertion: np.ndarray, origin: np.ndarray) -> None:
        self.insertion = insertion
        self.ends = np.stack([insertion, np.add(insertion, [0.001, 0.0, 0.002])]), np.stack([origin, origin])


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
    frames = (
        np.stack([np.concatenate([first, np.add(first, [0, 0, length])])] * 2) + np.array([0.0, 7.0])[:, None, None]
    )
    vertices, triangles = ribbon(frames, 2.0)
    for k in range(2):
        plate = closed(vertices[k], triangles)
        assert plate.volume == pytest.approx(9.0 * length * 2.0, rel=1e-5)  # outward: positive
        np.testing.assert_allclose(plate.centroid, [7 * k, 4.5 + 7 * k, 15 + 7 * k], atol=1e-4)


def test_strands_side_by_side_are_one_ribbon_in_their_order_across():
    strands = fan(0.006)
    vertices, triangles = line_shape(strands)
    assert closed(vertices[0], triangles).volume > 0
    middles = vertices.reshape(2, 4, 4, 3)[:, :, [0, 3]].mean(axis=2)  # of either side of each strand, at its insertion
    order = np.argsort(middles[0, :, 1])
    assert order.tolist() in ([0, 1, 2, 3], [3, 2, 1, 0])
    np.testing.assert_allclose(middles[:, order], 1e3 * np.sort(strands.ends[0], axis=1), atol=1e-3)


@pytest.mark.parametrize("strands", [fan(0.013), Strands(np.eye(3)[:2] * 0.005, np.eye(3)[:2] * 0.05)])
def test_muscles_apart_and_pairs_are_tubes(strands):
    expected = tubes(1e3 * np.concatenate(strands.ends, axis=1), 0.55, 10)
    for one, other in zip(line_shape(strands), expected, strict=True):
        np.testing.assert_array_equal(one, other)
