"""Moving shapes of tendons, ligaments and muscles: a ribbon through adjacent lines, tubes otherwise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.results.viewer.recorded import FEW, Lines
from pftwin.results.viewer.shapes import MM, directions, ring_triangles, tubes, units

Moving = tuple[NDArray[np.float32], NDArray[np.uint32]]  # vertices (n, v, 3) [mm] at n frames, triangles (m, 3)
CLOSE = 12.0  # largest distance between neighbouring lines of a ribbon [mm]
THICKNESS = 2.0  # of a ribbon [mm]


def line_shape(lines: Lines) -> Moving:
    """Returns the shape of one effect's lines at the shown frames, in the femur frame."""
    paths = MM * lines.paths
    order = _side_by_side(paths[0])
    if order is not None:
        return ribbon(paths[:, order], THICKNESS)
    return tubes(paths, MM * lines.radius, 10 if len(lines.insertion) <= FEW else 5)


def ribbon(lines: Floats, thickness: float) -> Moving:
    """Returns a sheet through lines that move.

    Args:
        lines: k lines through m points at n frames, in order across the ribbon (n, k, m, 3) [mm].
        thickness: thickness of the sheet [mm].
    """
    n, k, m, _ = lines.shape
    across = np.asarray(np.gradient(lines.mean(axis=2), axis=1))
    half = 0.5 * thickness * units(np.cross(directions(lines), across[:, :, None]))
    rings = np.concatenate([lines + half, (lines - half)[:, :, ::-1]], axis=2)  # (n, k, 2 m, 3)
    at = np.arange(k * 2 * m).reshape(k, 2 * m)
    a = np.arange(m - 1)
    b, c, d = a + 1, 2 * m - 2 - a, 2 * m - 1 - a
    edge = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    faces = np.concatenate([ring_triangles(at[1:], at[:-1]).reshape(-1, 3), at[0, ::-1][edge], at[-1][edge]])
    return rings.reshape(n, -1, 3).astype(np.float32), faces.astype(np.uint32)


def _side_by_side(lines: Floats) -> NDArray[np.int64] | None:
    """Order across the ribbon (k,) of lines (k, m, 3) [mm] with neighbouring ends close together; otherwise None."""
    if len(lines) < 3:
        return None
    ends = lines[:, [0, -1]]
    middle = ends.sum(axis=1) - ends.sum(axis=1).mean(axis=0)
    order = np.argsort(middle @ np.linalg.svd(middle)[2][0])
    gaps = np.linalg.norm(np.diff(ends[order], axis=0), axis=-1)
    return order if gaps.max() < CLOSE else None
