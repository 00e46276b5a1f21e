"""Steps of the search for the trochlea: circle fit, axis of revolution, deepest points. NumPy, on the host.

Points and normals are in a frame with x proximal, y medial-lateral, z anterior; the axis is parallel to y through
`center` = (x, z). Units are metres and radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError

CHECK_DIRECTIONS = "check the anterior and proximal directions against the mesh's frame"
_SECTION = np.radians(4.0)  # spacing of the groove line's points
_WINDOW = 0.010  # half width, medial-lateral, of the search for the deepest point [m]


def fit_circle(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centre (2,) and radius of the least-squares circle through points (n, 2), by Kasa's algebraic fit."""
    shift = points.mean(axis=0)
    q = points - shift
    solution = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), (q * q).sum(axis=1), rcond=None)[0]
    center = solution[:2]
    return center + shift, float(np.sqrt(solution[2] + center @ center))


def fit_axis_direction(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    areas: NDArray[np.float64],
    center: NDArray[np.float64],
    source: str = "mesh",
) -> NDArray[np.float64]:
    """Rotation (3, 3) that turns y onto the axis of the best-fitting surface of revolution.

    The normal line through p along n meets the axis through c along d if d . (p x n) - (c x d) . n = 0, which is linear
    in d and c x d and gives a small eigenvalue problem. A regularization towards y decides where the surface does not.
    Source: Pottmann and Randrup, Computing 60 (1998) 307. Raises InputError if no part of the surface faces away from
    the axis, or that part is flat or a cylindrical sheet.
    """
    arm = points - np.array([center[0], 0.0, center[1]])
    away = np.stack([arm[:, 0], np.zeros(len(arm)), arm[:, 2]], axis=1)
    size = np.linalg.norm(away, axis=1)
    angle = np.arctan2(arm[:, 0], arm[:, 2])
    use = (np.einsum("ij,ij->i", away, normals) > 0.4 * size) & (angle > np.radians(-100)) & (angle < np.radians(30))
    if not use.any() or np.linalg.matrix_rank(normals[use], tol=1e-6) < 3:
        found = (
            "what faces away from the surface's axis, forward or distally, is nothing or a flat or cylindrical sheet"
        )
        raise InputError(found, where=source, remedy=CHECK_DIRECTIONS)
    scale = np.median(size[use])
    q, n, w = arm[use] / scale, normals[use], areas[use] / areas[use].sum()
    q[:, 1] -= np.average(q[:, 1], weights=w)
    rows = np.concatenate([np.cross(q, n), -n], axis=1)
    m = rows.T @ (rows * w[:, None])
    y = np.array([0.0, 1.0, 0.0])
    reduced = m[:3, :3] - m[:3, 3:] @ np.linalg.solve(m[3:, 3:], m[3:, :3]) + 0.01 * (np.eye(3) - np.outer(y, y))
    d = np.linalg.eigh(reduced)[1][:, 0]
    d = d if d[1] > 0 else -d
    x = np.cross(d, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return np.stack([x, d, np.cross(x, d)], axis=1)


def deepest_points(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    center: NDArray[np.float64],
    middle: float,
    half_width: float,
    angles: tuple[float, float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Groove line as (angle, y, distance from the axis), (k, 3), from distal to proximal, and its depth (k,).

    Each section has one point, from a parabola fitted around the lowest vertices. The line is the longest run of
    sections without a gap in the surface or a jump of the groove's bottom (it ends at the notch).
    """
    x, z = points[:, 0] - center[0], points[:, 2] - center[1]
    angle, distance, y = np.arctan2(x, z), np.hypot(x, z), points[:, 1] - middle
    facing = normals[:, 0] * np.sin(angle) + normals[:, 2] * np.cos(angle) > 0.4
    use = np.flatnonzero(facing & (np.abs(y) <= half_width))
    count = max(int((angles[1] - angles[0]) / _SECTION), 1)
    sections = np.linspace(angles[0], angles[1], count + 1)
    sections = 0.5 * (sections[1:] + sections[:-1])
    rows: list[tuple[float, float, float, float] | None] = []
    for t in sections:
        k = use[np.abs(angle[use] - t) <= 0.6 * _SECTION]
        found = _bottom(y[k], distance[k])
        rows.append(None if found is None else (t, found[0] + middle, found[1], found[2]))
    run = _longest_run(rows)
    table = np.array(run).reshape(-1, 4)
    return table[:, :3], table[:, 3]


def _bottom(y: NDArray[np.float64], distance: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Position, height and depth of the groove in one section; None if there is no surface on both sides of it."""
    near = np.abs(y) <= _WINDOW
    if near.sum() < 5:
        return None
    edges = np.linspace(-_WINDOW, _WINDOW, 14)
    strip = np.digitize(y[near], edges)
    lowest = min(
        (float(distance[near][strip == s].mean()), float(y[near][strip == s].mean())) for s in np.unique(strip)
    )
    around = np.abs(y - lowest[1]) <= 0.5 * _WINDOW
    if around.sum() < 4 or np.ptp(y[around]) < 0.4 * _WINDOW:
        return None
    a, b, c = np.polyfit(y[around] - lowest[1], distance[around], 2)
    bottom = float(np.clip(-b / (2 * a), -0.25 * _WINDOW, 0.25 * _WINDOW)) if a > 0 else 0.0
    height = float(c + b * bottom + a * bottom**2)
    place = lowest[1] + bottom
    left, right = distance[y < place], distance[y > place]
    if not left.size or not right.size:
        return None
    return place, height, min(float(left.max()), float(right.max())) - height


def _longest_run(rows: list[tuple[float, float, float, float] | None]) -> list[tuple[float, float, float, float]]:
    """Longest run of sections with a groove and without jumps of 1.5 mm in height or 3 mm sideways."""
    best: list[tuple[float, float, float, float]] = []
    run: list[tuple[float, float, float, float]] = []
    for row in rows:
        if row is None:
            run = []
            continue
        goes_on = run and abs(row[2] - run[-1][2]) < 1.5e-3 and abs(row[1] - run[-1][1]) < 3e-3
        run = [*run, row] if goes_on else [row]
        if len(run) > len(best):
            best = run
    return best
