"""Detects and repairs mislabelled or misplaced markers of a cluster, which leave its shape for some frames.

Skin moves markers of a segment relative to each other, but slowly. Frames in which they jump relative to each other are
detected like the outliers of a patella (`pftwin.files.mocap.bones`). For each such frame the simplest explanation is
searched: two markers exchanged, one misplaced, two misplaced. The reference is the cluster's shape in the good frames
around.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.arrays import Floats
from pftwin.files.mocap.bones import Frames, coasts, in_words, out_of_line
from pftwin.files.mocap.frames import cluster_poses, spans_plane
from pftwin.files.mocap.markers import MarkerTrajectories

_ALLOWANCE = 8e-3  # [m] relative motion of markers by skin and noise that is always allowed, or, if larger,
_STEPS = 5.0  # this multiple of their usual step between frames (lower quartile); in addition
_SPEED, _DRIFT = 0.15, 0.04  # [m/s] speeds of skin, for a few frames, and for longer times
_CLEARER = 3.0  # factor by which an explanation must fit better than the next one of its kind
Kind = Literal["in place", "exchanged", "left out", "unexplained"]


@dataclass(frozen=True, eq=False)
class Stray:
    """Markers of a cluster that were misplaced, how they were repaired, and in which frames (n,)."""

    markers: tuple[str, ...]
    kind: Kind
    frames: NDArray[np.bool_]

    def in_words(self) -> str:
        """Description of the repair and its frames."""
        names = ", ".join(self.markers)
        where = f"{in_words(self.frames)} of {self.frames.size} (counted from 1)"
        if self.kind == "left out":
            return f"{names} left out in {where}: astray from the markers beside"
        if self.kind == "exchanged":
            return f"{names} exchanged in {where}: put back"
        few = " with three markers nothing tells which is astray" if len(self.markers) < 4 else " nothing tells which"
        return f"{names} jump against each other in {where}, and are left as they are:{few}"


def mended_cluster(
    markers: MarkerTrajectories, reference: Mapping[str, ArrayLike]
) -> tuple[MarkerTrajectories, list[Stray]]:
    """Repairs a cluster: misplaced markers are placed by means of the others, exchanged markers are swapped back.

    With fewer than four markers, or if two explanations fit about equally well, frames are not changed and are reported
    as unexplained.

    Args:
        markers: as recorded, before gaps are filled; NaN where missing.
        reference: each marker's position (3,) [m] in the segment's frame, as for `segment_poses`.

    Returns:
        The cluster's markers, and the repairs and unexplained frames.
    """
    names = list(reference)
    chosen = markers.select(names)
    places = np.array([*reference.values()], dtype=np.float64)
    present = ~chosen.missing
    known = np.broadcast_to(places, chosen.positions.shape)
    usable = np.flatnonzero(spans_plane(chosen.positions, present) & spans_plane(known, present))
    if usable.size < 2:
        return chosen, []
    cluster = _Cluster(chosen.positions[usable], chosen.times[usable], places)
    positions = chosen.positions.copy()
    found: dict[tuple[Kind, tuple[str, ...]], list[int]] = defaultdict(list)
    for k in np.flatnonzero(cluster.odd):
        kind, at, moved = cluster.explained(int(k))
        if kind != "in place":
            found[kind, tuple(names[i] for i in at)].append(int(usable[k]))
            positions[usable[k]] = moved
    every = np.arange(len(present))
    strays = [Stray(which, kind, np.isin(every, frames)) for (kind, which), frames in found.items()]
    return chosen.with_positions(positions), strays


class _Cluster:
    """Markers (n, m, 3) of a cluster, also in the cluster's frame."""

    def __init__(self, positions: Floats, times: Floats, places: Floats) -> None:
        self.positions, self.times, self.places = positions, times, places
        poses = cluster_poses(positions, places, times)
        self._local = np.einsum("nji,nmj->nmi", poses.matrices(), positions - poses.positions[:, None])
        steps = self._moved(np.arange(times.size - 1), np.arange(1, times.size))
        self.usual_step = float(np.quantile(steps, 0.25))
        self.coasting = coasts(times)
        self.allowance = max(_ALLOWANCE, _STEPS * self.usual_step)

        def reached(earlier: Frames, later: Frames | int, passed: Floats) -> NDArray[np.bool_]:
            return self._moved(earlier, later) <= self._room(passed)

        self.odd = out_of_line(times, reached, coasting=np.inf)

    def _room(self, passed: Floats) -> Floats:
        """Relative motion of markers [m] that is allowed in some seconds."""
        return self.allowance + _SPEED * np.minimum(passed, self.coasting) + _DRIFT * passed

    def _moved(self, one: Frames, other: Frames | int) -> Floats:
        """Largest motion of a marker in the cluster's frame between frames [m]."""
        away = np.linalg.norm(self._local[one] - self._local[other], axis=-1)
        return np.where(np.isnan(away), 0.0, away).max(axis=-1)

    def explained(self, k: int) -> tuple[Kind, Sequence[int], Floats]:
        """Explanation of a frame: its kind, the markers concerned, and all markers' repaired positions (m, 3) [m]."""
        good = np.flatnonzero(~self.odd)
        room = float(self._room(np.abs(self.times[good] - self.times[k]).min()))
        shape, present = self._shape(k, good), np.flatnonzero(np.isfinite(self.positions[k]).all(axis=1))
        for kind, at, measured in _explanations(self.positions[k], present):
            usable = spans_plane(measured, ~np.isnan(measured[..., 0]))
            if not usable.any():
                continue
            measured = measured[usable]
            poses = cluster_poses(measured, shape, np.arange(len(measured), dtype=float))
            fitted = poses.positions[:, None] + np.einsum("nij,mj->nmi", poses.matrices(), shape)
            misfit = np.nanmax(np.linalg.norm(measured - fitted, axis=2), axis=1)
            order = np.argsort(misfit)
            best = order[0]
            clear = len(order) == 1 or misfit[order[1]] > _CLEARER * max(misfit[best], self.usual_step)
            if misfit[best] <= room and clear:
                which = [a for a, there in zip(at, usable, strict=True) if there][best]
                put = np.where(np.isnan(measured[best]), fitted[best], measured[best])
                put[~np.isin(np.arange(len(put)), present)] = np.nan  # not seen in this frame
                return kind, which, put
        return "unexplained", present.tolist(), self.positions[k]

    def _shape(self, k: int, good: Frames) -> Floats:
        """Positions (m, 3) in the cluster's frame, interpolated between the good frames around [m]."""
        shape = self.places.copy()
        for i in range(len(shape)):
            there = good[np.isfinite(self._local[good, i, 0])]
            if there.size:
                shape[i] = [np.interp(self.times[k], self.times[there], self._local[there, i, c]) for c in range(3)]
        return shape


def _explanations(points: Floats, present: Frames) -> Iterator[tuple[Kind, list[tuple[int, ...]], Floats]]:
    """Hypotheses of each kind, simplest first: the markers concerned, and positions (h, m, 3) without the mistake."""
    yield "in place", [()], points[None]
    if present.size < 4:
        return
    pairs = list(combinations(present.tolist(), 2))
    exchanged = np.repeat(points[None], len(pairs), axis=0)
    for h, (i, j) in enumerate(pairs):
        exchanged[h, [i, j]] = points[[j, i]]
    yield "exchanged", pairs, exchanged
    for out in [(i,) for i in present.tolist()], pairs:
        if present.size - len(out[0]) >= 3:
            without = np.repeat(points[None], len(out), axis=0)
            for h, which in enumerate(out):
                without[h, list(which)] = np.nan
            yield "left out", list(out), without
