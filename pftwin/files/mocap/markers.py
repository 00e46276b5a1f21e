"""Marker trajectories: positions of named points over time, with plausibility checks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.mocap.tables import Sampled, uniform_times, unknown_name

# [m] Plausible extent of all markers: from the size of a marker cluster to that of a large laboratory.
_SMALLEST_EXTENT, _LARGEST_EXTENT = 0.01, 50.0
# [m] Markers are balls of 6 to 14 mm, and cameras merge two that nearly touch; six markers are on two or more segments.
# If centimetres are labelled as millimetres, nearest neighbours are 4 to 9 "mm" apart.
_NEAREST, _SMALLEST_OF_SIX = 0.012, 0.1
_FASTEST = 100.0  # [m/s] markers on limbs reach 10 m/s, on a golf club 50 m/s


@dataclass(frozen=True, eq=False)
class MarkerTrajectories(Sampled):
    """Positions of m markers at n uniformly spaced times.

    Args:
        times: (n,) seconds, strictly increasing and uniformly spaced; rounding of printed times is removed.
        names: m unique marker names.
        positions: (n, m, 3) metres; NaN where a marker is missing (all three coordinates together).
        source: origin of the data, for messages.

    Raises:
        InputError: non-uniform, repeated or unsorted times (naming the row), shapes that do not match, repeated names.
    """

    times: NDArray[np.float64]
    names: tuple[str, ...]
    positions: NDArray[np.float64]
    source: str = "markers"

    def __post_init__(self) -> None:
        times, names = uniform_times(self.times, where=self.source), tuple(self.names)
        positions = self._array("positions", (times.size, len(names), 3))
        refuse_repeated(names, "marker names", where=self.source)
        if (bad := np.argwhere(np.isinf(positions).any(axis=-1))).size:
            found = f"marker {names[bad[0][1]]!r} is infinite on row {bad[0][0] + 1}"
            raise InputError(found, where=self.source, expected="finite or NaN")
        positions[np.isnan(positions).any(axis=-1)] = np.nan
        self._set(times=times, names=names, positions=positions)

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Where a marker is missing, (n, m)."""
        return np.isnan(self.positions[..., 0])

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise unknown_name("marker", name, self.names, where=self.source)
        return self.names.index(name)

    def marker(self, name: str) -> NDArray[np.float64]:
        """Trajectory (n, 3) [m] of a marker; for an unknown name raises InputError with the closest known names."""
        return self.positions[:, self._index(name)]

    def select(self, names: Sequence[str]) -> MarkerTrajectories:
        """The named markers, in this order."""
        index = [self._index(name) for name in names]
        return replace(self, names=tuple(names), positions=self.positions[:, index])

    def with_positions(self, positions: ArrayLike) -> MarkerTrajectories:
        """The same markers and times with other positions (n, m, 3) [m], for instance filtered ones."""
        return replace(self, positions=np.asarray(positions, dtype=np.float64))


def from_file(
    times: NDArray[np.float64],
    names: Sequence[str],
    positions: NDArray[np.float64],
    *,
    path: str | os.PathLike[str],
    unit_given: bool,
) -> MarkerTrajectories:
    """Makes and checks the markers of a file; positions that are exactly 0 0 0 are missing.

    Several systems write a missing marker as 0 0 0 (or -0 0 0); no real marker is exactly at the laboratory's origin.

    Args:
        times: (n,) seconds.
        names: m markers.
        positions: (n, m, 3) metres; NaN where missing.
        path: of the file, for messages.
        unit_given: whether the caller gave the unit; then unusual distances are accepted.

    Raises:
        InputError: as `MarkerTrajectories`. All markers together span more than 50 m, or two or more of them less than
            10 mm. Unless `unit_given`: most markers are less than 12 mm from the nearest other one, or six or more span
            less than 100 mm in most frames. A marker moves faster than 100 m/s between two frames in which it is
            present, for instance because of a number that encodes "missing".
    """
    positions = np.where((positions == 0).all(axis=-1, keepdims=True), np.nan, positions)
    _check_extent(positions, where=path, unit_given=unit_given)
    markers = MarkerTrajectories(times, tuple(names), positions, source=str(path))
    _check_jumps(markers)
    return markers


def _check_extent(positions: NDArray[np.float64], *, where: object, unit_given: bool) -> None:
    present = positions[np.isfinite(positions).all(axis=-1)]
    if not len(present):
        return
    extent = float(np.max(present.max(axis=0) - present.min(axis=0)))
    several = positions.shape[1] > 1
    if extent > _LARGEST_EXTENT or (several and extent < _SMALLEST_EXTENT):
        raise InputError(
            f"the markers span {extent:.4g} m in the file's unit: that unit looks wrong",
            where=where,
            expected=f"an extent between {_SMALLEST_EXTENT} m and {_LARGEST_EXTENT:g} m",
            remedy="the true unit as argument: units='mm' (or 'm', 'cm')",
        )
    if not unit_given and several:
        _check_distances(positions, where)


def _check_distances(positions: NDArray[np.float64], where: object) -> None:
    some = positions[:: max(1, len(positions) // 20)]  # about twenty frames
    distances = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
    positive = distances[np.isfinite(distances) & (distances > 0)]  # virtual markers may coincide
    if not positive.size:
        return
    distances[~(distances > 0)] = np.inf
    nearest = distances.min(axis=2)
    near = float(np.median(nearest[np.isfinite(nearest)]))
    present = np.asarray(np.isfinite(some).all(axis=2), dtype=np.bool_)
    across = [float(np.ptp(p[s], axis=0).max()) for p, s in zip(some, present, strict=True) if s.sum() >= 6]
    size = float(np.median(across)) if across else np.inf
    if near >= _NEAREST and size >= _SMALLEST_OF_SIX:
        return
    found = f"markers are {near * 1e3:.3g} mm from the nearest other one"
    if near >= _NEAREST:
        found = f"six markers or more span {size * 1e3:.3g} mm"
    raise InputError(
        f"{found} in the file's unit: that unit looks wrong",
        where=where,
        expected=f"{_NEAREST * 1e3:g} mm or more between markers, {_SMALLEST_OF_SIX * 1e3:g} mm across six of them",
        remedy="the true unit as argument, the file's own too if it is right: units='cm' (or 'mm', 'm')",
    )


def _check_jumps(markers: MarkerTrajectories) -> None:
    for i, name in enumerate(markers.names):
        rows = np.flatnonzero(~markers.missing[:, i])
        steps = np.linalg.norm(np.diff(markers.positions[rows, i], axis=0), axis=1)
        fast = np.flatnonzero(steps > _FASTEST * np.diff(markers.times[rows]))
        if fast.size:
            first, row = fast[0], rows[fast[0] + 1]
            x, y, z = markers.positions[row, i]
            found = f"marker {name!r} jumps by {steps[first]:.3g} m to ({x:.4g}, {y:.4g}, {z:.4g}) m on row {row + 1}"
            remedy = "empty cells where a marker was not seen; else check the unit and the times"
            raise InputError(found, where=markers.source, expected=f"at most {_FASTEST:g} m/s", remedy=remedy)
