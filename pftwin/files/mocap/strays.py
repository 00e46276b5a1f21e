"""Markers that leave the cluster they belong to for some frames: hidden, taken for another one, or exchanged.

Skin moves markers of a segment against each other, slowly. Frames in which they jump against each other are found as
those of a patella are (`pftwin.files.mocap.jumps`). For each the simplest mistake is looked for that explains it: two
markers exchanged, one astray, two astray. What is judged is the cluster's shape, by that in the good frames around.
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
from pftwin.files.mocap.frames import cluster_poses, spans_plane
from pftwin.files.mocap.jumps import Frames, coasts, in_words, out_of_line
from pftwin.files.mocap.markers import MarkerTrajectories

_APART = 8e-3  # [m] by which skin and noise may move markers against each other, however soon, or
_STEPS = 5.0  # times their usual step between frames, the lower quartile; and besides
_SPEED, _DRIFT = 0.15, 0.04  # [m/s] of skin, for a few frames, and for long
_CLEARER = 3.0  # times as well has an explanation to fit as the next one of its kind
Kind = Literal["in place", "exchanged", "left out", "unexplained"]


@dataclass(frozen=True, eq=False)
class Stray:
    """Markers of a cluster, what was done about them, and in which frames (n,)."""

    markers: tuple[str, ...]
    kind: Kind
    frames: NDArray[np.bool_]

    def in_words(self) -> str:
        """What was done, and where, for people."""
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
    """The markers of a cluster, those that stray put where the others say, and those that were exchanged put back.

    Nothing is decided with fewer than four markers, nor where two explanations fit about alike: such frames stay as
    they are and are told as unexplained.

    Args:
        markers: as recorded, before gaps are filled; NaN where missing.
        reference: each marker's place (3,) [m] in the segment's frame, as of `segment_poses`.
    """
    names = list(reference)
    chosen = markers.select(names)
    places = np.array([*reference.values()], dtype=np.float64)
    seen = ~chosen.missing
    known = np.broadcast_to(places, chosen.positions.shape)
    usable = np.flatnonzero(spans_plane(chosen.positions, seen) & spans_plane(known, seen))
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
    every = np.arange(len(seen))
    strays = [Stray(which, kind, np.isin(every, frames)) for (kind, which), frames in found.items()]
    return chosen.with_positions(positions), strays


class _Cluster:
    """Markers (n, m, 3) of a cluster, and where they are in it."""

    def __init__(self, positions: Floats, times: Floats, places: Floats) -> None:
        self.positions, self.times, self.places = positions, times, places
        poses = cluster_poses(positions, places, times)
        self._local = np.einsum("nji,nmj->nmi", poses.matrices(), positions - poses.positions[:, None])
        steps = self._moved(np.arange(times.size - 1), np.arange(1, times.size))
        self.usual_step = float(np.quantile(steps, 0.25))
        self.coasting = coasts(times)
        self.apart = max(_APART, _STEPS * self.usual_step)

        def reached(earlier: Frames, later: Frames | int, passed: Floats) -> NDArray[np.bool_]:
            return self._moved(earlier, later) <= self._room(passed)

        self.odd = out_of_line(times, reached, coasting=np.inf)

    def _room(self, passed: Floats) -> Floats:
        """How far markers may move against each other in some seconds [m]."""
        return self.apart + _SPEED * np.minimum(passed, self.coasting) + _DRIFT * passed

    def _moved(self, one: Frames, other: Frames | int) -> Floats:
        """How far the marker that moved most in the cluster did between frames [m]."""
        away = np.linalg.norm(self._local[one] - self._local[other], axis=-1)
        return np.where(np.isnan(away), 0.0, away).max(axis=-1)

    def explained(self, k: int) -> tuple[Kind, Sequence[int], Floats]:
        """What happened in a frame, to which markers, and all markers' places (m, 3) put right [m]."""
        good = np.flatnonzero(~self.odd)
        room = float(self._room(np.abs(self.times[good] - self.times[k]).min()))
        shape, seen = self._shape(k, good), np.flatnonzero(np.isfinite(self.positions[k]).all(axis=1))
        for kind, at, measured in _explanations(self.positions[k], seen):
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
                put[~np.isin(np.arange(len(put)), seen)] = np.nan  # never seen there
                return kind, which, put
        return "unexplained", seen.tolist(), self.positions[k]

    def _shape(self, k: int, good: Frames) -> Floats:
        """Places (m, 3) in the cluster as the good frames around have them [m]."""
        shape = self.places.copy()
        for i in range(len(shape)):
            there = good[np.isfinite(self._local[good, i, 0])]
            if there.size:
                shape[i] = [np.interp(self.times[k], self.times[there], self._local[there, i, c]) for c in range(3)]
        return shape


def _explanations(points: Floats, seen: Frames) -> Iterator[tuple[Kind, list[tuple[int, ...]], Floats]]:
    """Mistakes of each kind, simplest first: which markers, and the others' places (h, m, 3) without the mistake."""
    yield "in place", [()], points[None]
    if seen.size < 4:
        return
    pairs = list(combinations(seen.tolist(), 2))
    exchanged = np.repeat(points[None], len(pairs), axis=0)
    for h, (i, j) in enumerate(pairs):
        exchanged[h, [i, j]] = points[[j, i]]
    yield "exchanged", pairs, exchanged
    for out in [(i,) for i in seen.tolist()], pairs:
        if seen.size - len(out[0]) >= 3:
            without = np.repeat(points[None], len(out), axis=0)
            for h, which in enumerate(out):
                without[h, list(which)] = np.nan
            yield "left out", list(out), without
