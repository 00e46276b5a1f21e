"""Moving shapes of tendons, ligaments and muscles: a ribbon through adjacent lines, tubes otherwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.results.viewer.recorded import FEW, Lines
from pftwin.results.viewer.shapes import MM, ring_triangles, tubes

Moving = tuple[NDArray[np.float32], NDArray[np.uint32]]  # vertices (n, v, 3) [mm] at n frames, triangles (m, 3)
CLOSE = 12.0  # largest distance between neighbouring lines of a ribbon [mm]
THICKNESS = 2.0  # of a ribbon [mm]


def line_shape(lines: Lines) -> Moving:
    """Returns the shape of one effect's lines at the shown frames, in the femur frame."""
    ends = MM * np.concatenate(lines.ends, axis=1)
    order = _side_by_side(ends[0])
    if order is not None:
        return ribbon(ends[:, order.ravel()], THICKNESS)
    return tubes(ends, MM * lines.radius, 10 if len(lines.insertion) <= FEW else 5)


def ribbon(ends: Floats, thickness: float) -> Moving:
    """Returns a sheet through k straight lines whose ends move.

    Args:
        ends: the lines' first ends, in order across the ribbon, then their second ends, at n frames (n, 2 k, 3) [mm].
        thickness: thickness of the sheet [mm].
    """
    first, second = np.split(ends, 2, axis=1)
    across = np.asarray(np.gradient(first + second, axis=1))
    normal = np.cross(second - first, across)
    half = 0.5 * thickness * normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    rings = np.stack([first + half, second + half, second - half, first - half], axis=2)  # (n, k, 4, 3)
    k = np.arange(4 * first.shape[1]).reshape(-1, 4)
    edges = np.concatenate([ring[[[0, 1, 2], [0, 2, 3]]] for ring in (k[0, ::-1], k[-1])])
    faces = np.concatenate([ring_triangles(k[1:], k[:-1]).reshape(-1, 3), edges])
    return rings.reshape(len(ends), -1, 3).astype(np.float32), faces.astype(np.uint32)


def _side_by_side(ends: Floats) -> NDArray[np.int64] | None:
    """Order across the ribbon (2, k) of lines with neighbouring ends (2 k, 3) [mm] close together; otherwise None."""
    first, second = np.split(ends, 2)
    if len(first) < 3:
        return None
    middle = first + second - (first + second).mean(axis=0)
    order = np.argsort(middle @ np.linalg.svd(middle)[2][0])
    gaps = [np.linalg.norm(np.diff(e[order], axis=0), axis=1).max() for e in (first, second)]
    return np.stack([order, order + len(first)]) if max(gaps) < CLOSE else None
