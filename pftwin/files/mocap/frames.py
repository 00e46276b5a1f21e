"""Segments' poses from markers: three points (Vaughan), or a least-squares fit to all markers of a cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import shortened_list
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.poses import PoseSeries

# Ratio of width to length below which points count as collinear: 0.2 mm of noise on 10 mm of width is already 1 deg.
_COLLINEAR = 0.02


def three_point_frames(
    a: ArrayLike, b: ArrayLike, c: ArrayLike, times: ArrayLike, *, axes: str = "xy", source: str = "three points"
) -> PoseSeries:
    """Poses from three points, after Vaughan et al. (1992), Dynamics of Human Gait, chapter 3.

    The origin is `a`. The first of `axes` points from a to b; the second is in the plane of the three points, on c's
    side; the third completes a right-handed frame.

    Args:
        a, b, c: (n, 3) metres.
        times: (n,) seconds.
        axes: two different letters of "xyz". "xy": x along a-b, y towards c.
        source: for messages.

    Raises:
        InputError: missing points, points that coincide or are collinear (naming the frames, from 1), unknown axes.
    """
    if len(axes) != 2 or len(set(axes)) != 2 or not set(axes) <= set("xyz"):
        raise InputError(f"axes {axes!r}", where="axes", expected="two different letters of xyz, as in 'xy'")
    a, b, c = (np.asarray(p, dtype=np.float64) for p in (a, b, c))
    for name, p in zip("abc", (a, b, c), strict=True):
        if p.ndim != 2 or p.shape != a.shape or p.shape[1] != 3:
            raise InputError(
                f"point {name} has the shape {p.shape}", where=source, expected="(n, 3), alike for a, b, c"
            )
        if (bad := np.flatnonzero(~np.isfinite(p).all(axis=1))).size:
            raise InputError(f"point {name} is missing in frames {shortened_list(bad + 1)} (from 1)", where=source)
    along, side = b - a, c - a
    normal = np.cross(along, side)
    length = np.linalg.norm(along, axis=1) * np.linalg.norm(side, axis=1)
    if (bad := np.flatnonzero(~(np.linalg.norm(normal, axis=1) > _COLLINEAR * length))).size:
        found = f"the three points lie on a line in frames {shortened_list(bad + 1)} (from 1)"
        raise InputError(found, where=source, expected="three points that span a plane")
    first = along / np.linalg.norm(along, axis=1, keepdims=True)
    third = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    second = np.cross(third, first)
    i, j = ("xyz".index(letter) for letter in axes)
    handed = 1.0 if (j - i) % 3 == 1 else -1.0
    matrices = np.empty((a.shape[0], 3, 3))
    matrices[:, :, i], matrices[:, :, j], matrices[:, :, 3 - i - j] = first, second, handed * third
    return PoseSeries.from_matrices(times, a, matrices, source=source)


def cluster_poses(
    measured: ArrayLike,
    reference: ArrayLike,
    times: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    source: str = "cluster",
) -> PoseSeries:
    """Least-squares poses of a cluster of markers (Kabsch 1976; Soederkvist & Wedin 1993).

    Each frame uses the markers that are present (not NaN). The rotation is always proper.

    Args:
        measured: (n, m, 3) metres in the laboratory; NaN where missing.
        reference: (m, 3) metres, the same markers in the segment's frame.
        times: (n,) seconds.
        names: the markers' names, for messages.
        source: for messages.

    Returns:
        Poses of the segment's frame in the laboratory; `residual_rms` is the root mean square distance of a frame's
        markers from their fitted positions [m].

    Raises:
        InputError: wrong shapes, a missing reference marker, frames with fewer than three markers or collinear ones
            (naming frames, from 1, and markers).
    """
    p, r = np.asarray(measured, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if p.ndim != 3 or r.shape != p.shape[1:] or r.shape[1:] != (3,):
        found = f"markers of shape {p.shape} and a reference of shape {r.shape}"
        raise InputError(found, where=source, expected="(n, m, 3) and (m, 3)")
    labels = list(names) if names is not None else [f"marker {i}" for i in range(r.shape[0])]
    if not np.isfinite(r).all():
        bad = [labels[i] for i in np.flatnonzero(~np.isfinite(r).all(axis=1))]
        raise InputError(
            f"the reference lacks {shortened_list(bad)}", where=source, expected="all markers in the reference"
        )
    present = _present(p, labels, source)
    weight = (present / present.sum(axis=1, keepdims=True))[:, :, None]  # (n, m, 1)
    p = np.where(present[:, :, None], p, 0.0)
    p_mean, r_mean = (weight * p).sum(axis=1), (weight * r).sum(axis=1)  # (n, 3)
    p_centred, r_centred = (p - p_mean[:, None]) * present[:, :, None], (r - r_mean[:, None]) * present[:, :, None]
    for label, points in (("reference", r_centred), ("measured", p_centred)):
        _refuse_lines(points, present, labels, f"the {label} markers", source)

    u, _, vt = np.linalg.svd(np.einsum("nmi,nmj->nij", p_centred, r_centred))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    matrices = u @ vt
    positions = p_mean - np.einsum("nij,nj->ni", matrices, r_mean)
    misfit = p_centred - np.einsum("nij,nmj->nmi", matrices, r_centred)
    residual = np.sqrt((weight * misfit**2).sum(axis=(1, 2)))
    return PoseSeries.from_matrices(times, positions, matrices, residual_rms=residual, source=source)


def _present(measured: NDArray[np.float64], labels: list[str], source: str) -> NDArray[np.bool_]:
    """Which markers of (n, m, 3) are present in which frame (n, m); InputError for a frame with fewer than three."""
    present = np.asarray(np.isfinite(measured).all(axis=2), dtype=np.bool_)
    if (few := np.flatnonzero(present.sum(axis=1) < 3)).size:
        absent = [labels[i] for i in np.flatnonzero(~present[few[0]])]
        raise InputError(
            f"fewer than three markers of {shortened_list(labels)} in frames {shortened_list(few + 1)} (from 1)"
            + (f"; frame {few[0] + 1} lacks {shortened_list(absent)}" if absent else ""),
            where=source,
            expected="at least three markers seen",
            remedy="fill the gaps, or use a part of the recording",
        )
    return present


def segment_poses(markers: MarkerTrajectories, reference: Mapping[str, ArrayLike], *, source: str = "") -> PoseSeries:
    """`cluster_poses` by marker names: `reference` has each marker's position (3,) [m] in the segment's frame."""
    names = list(reference)
    chosen = markers.select(names)
    places = np.array([*reference.values()], dtype=np.float64)
    label = source or f"{markers.source}, segment of {shortened_list(names)}"
    return cluster_poses(chosen.positions, places, chosen.times, names=names, source=label)


def mean_cluster(markers: MarkerTrajectories, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Mean shape of a cluster over a recording by generalised Procrustes analysis, as `reference` without static trial.

    The frame's origin is the mean of the markers; its axes are those of the laboratory in the first frame in which all
    markers are present.

    Raises:
        InputError: unknown names, no frame with all markers, fewer than three or collinear markers.
    """
    chosen = markers.select(names)
    complete = ~chosen.missing.any(axis=1)
    if not complete.any():
        raise InputError(f"no frame shows all of {shortened_list(names)}", where=markers.source)
    points = chosen.positions[complete]
    shape = points[0] - points[0].mean(axis=0)
    for _ in range(20):
        poses = cluster_poses(points, shape, chosen.times[complete], names=names, source=markers.source)
        local = np.einsum("nji,nmj->nmi", poses.matrices(), points - poses.positions[:, None])
        previous, shape = shape, local.mean(axis=0) - local.mean(axis=(0, 1))
        if np.abs(shape - previous).max() < 1e-12:
            break
    return dict(zip(names, shape, strict=True))


def spans_plane(points: NDArray[np.float64], present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which frames (n,) have three or more points (n, m, 3) that are `present` (n, m) and not collinear."""
    count = np.maximum(present.sum(axis=1), 1)[:, None, None]
    there = np.where(present[:, :, None], points, 0.0)
    centred = np.where(present[:, :, None], there - there.sum(axis=1, keepdims=True) / count, 0.0)
    eigenvalues = np.linalg.eigvalsh(np.einsum("nmi,nmj->nij", centred, centred))  # ascending, squared lengths
    return np.asarray(eigenvalues[:, 1] > _COLLINEAR**2 * eigenvalues[:, 2], dtype=np.bool_)


def _refuse_lines(
    centred: NDArray[np.float64], present: NDArray[np.bool_], labels: Sequence[str], what: str, source: str
) -> None:
    if (bad := np.flatnonzero(~spans_plane(centred, present))).size:
        used = [label for label, there in zip(labels, present[bad[0]], strict=True) if there]
        found = f"{what} {shortened_list(used)} lie on a line in frames {shortened_list(bad + 1)} (from 1)"
        raise InputError(found, where=source, expected="at least three markers that span a plane")
