"""Tables of signals over time (forces, lengths, angles), and checks of a recording's times."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import check_row_length, numbers, refuse_repeated

# Printed times are rounded (three decimals at 120 Hz: 6 % of an interval); a lost frame deviates by 100 %.
_ROUNDING_SHARE = 0.1


def increasing_times(times: ArrayLike, *, where: object) -> NDArray[np.float64]:
    """Times [s] as a float64 array of shape (n,), finite and strictly increasing.

    Raises:
        InputError: empty, not one-dimensional, not finite, repeated or unsorted; the message names the row (from 1).
    """
    t = np.asarray(times, dtype=np.float64)
    if t.ndim != 1 or not t.size:
        raise InputError(f"times of shape {t.shape}", where=where, expected="one time per frame, at least one")
    if (bad := np.flatnonzero(~np.isfinite(t))).size:
        raise InputError(f"row {bad[0] + 1} has no finite time", where=where, expected="a time in seconds on every row")
    if (bad := np.flatnonzero(np.diff(t) <= 0)).size:
        i = int(bad[0]) + 1
        now, before = (f"{v:.9g}" for v in (t[i], t[i - 1]))
        if t.any() and np.all(t == np.round(t)):  # files of poses may count frames
            found = f"repeats the time {now} (frame number or seconds)"
            back = f"goes back in time: {now} after {before} (frame numbers or seconds)"
        else:
            found, back = f"repeats the time {now} s", f"goes back in time: {now} s after {before} s"
        found = back if t[i] < t[i - 1] else found
        remedy = "sort the rows and remove repeated ones"
        raise InputError(f"row {i + 1} {found}", where=where, expected="strictly increasing times", remedy=remedy)
    return t


def uniform_times(times: ArrayLike, *, where: object) -> NDArray[np.float64]:
    """Replaces recorded times by the uniform grid t0 + i (t_last - t0) / (n - 1).

    Recorded times are a uniform grid, rounded when printed; the rounding would add noise to velocities.

    Raises:
        InputError: a time is more than a tenth of an interval from the grid; the message names the row.
    """
    t = increasing_times(times, where=where)
    if t.size < 3:
        return t
    grid = np.linspace(t[0], t[-1], t.size)
    interval = grid[1] - grid[0]
    if np.max(np.abs(t - grid)) > _ROUNDING_SHARE * interval:
        steps = np.diff(t)
        i = int(np.argmax(np.abs(steps - np.median(steps))))
        raise InputError(
            f"times are not evenly spaced: {steps[i]:.6g} s between rows {i + 1} and {i + 2}, "
            f"{np.median(steps):.6g} s elsewhere",
            where=where,
            expected="one sampling rate throughout",
            remedy="resample the recording, or mark lost frames as rows with empty cells",
        )
    return grid


class Sampled:
    """Base class of tables, markers and poses: arrays whose first axis is the n times."""

    if TYPE_CHECKING:
        times: NDArray[np.float64]
        source: str

    def _array(self, field: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """A copy of a field's array; raises InputError for another shape."""
        array = np.array(getattr(self, field), dtype=np.float64)
        if array.shape != shape:
            raise InputError(f"{field} of shape {array.shape}", where=self.source, expected=f"{shape}")
        return array

    def _set(self, **values: object) -> None:
        """Sets fields of the frozen dataclass while they are checked."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]; raises InputError for non-uniform times or a single frame."""
        if self.times.size < 2:
            raise InputError("one frame has no sampling rate", where=self.source, expected="at least two frames")
        grid = uniform_times(self.times, where=self.source)
        return float((grid.size - 1) / (grid[-1] - grid[0]))

    def between(self, start: float, end: float) -> Self:
        """Frames with start <= t <= end [s], within rounding error; raises InputError if there are none."""
        slack = 1e-9 * max(1.0, abs(start), abs(end))
        keep = (self.times >= start - slack) & (self.times <= end + slack)
        if not keep.any():
            expected = f"an interval within {self.times[0]:g} s to {self.times[-1]:g} s"
            raise InputError(f"no frame between {start:g} s and {end:g} s", where=self.source, expected=expected)
        arrays = {name: value[keep] for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return replace(self, **arrays)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, eq=False)
class Table(Sampled):
    """k named columns at n times, in SI units.

    Args:
        times: (n,) seconds, strictly increasing; may be non-uniform, as from adaptive integrators (then `rate` raises).
        names: k unique column names.
        values: (n, k); NaN where a cell was empty.
        units: unit of each column by name ("m", "rad", "N", "1", or "" if the file does not state it).
        source: origin of the data, for messages.
        in_degrees: flag of an OpenSim file; None for other files.

    Raises:
        InputError: repeated or unsorted times (naming the row), shapes that do not match, repeated names.
    """

    times: NDArray[np.float64]
    names: tuple[str, ...]
    values: NDArray[np.float64]
    units: Mapping[str, str] = field(default_factory=dict)
    source: str = "table"
    in_degrees: bool | None = None

    def __post_init__(self) -> None:
        times, names = increasing_times(self.times, where=self.source), tuple(self.names)
        values = self._array("values", (times.size, len(names)))
        refuse_repeated(names, "columns", where=self.source)
        units = {name: self.units.get(name, "") for name in names}
        self._set(times=times, names=names, values=values, units=units)

    def column(self, name: str) -> NDArray[np.float64]:
        """One column (n,); for an unknown name raises InputError with the closest known names."""
        if name not in self.names:
            raise unknown_name("column", name, self.names, where=self.source)
        return self.values[:, self.names.index(name)]

    def select(self, names: Sequence[str]) -> Table:
        """A table of the named columns, in this order."""
        values = np.stack([self.column(name) for name in names], axis=1)
        return replace(self, names=tuple(names), values=values)


def row_values(
    rows: Sequence[tuple[int, Sequence[str]]], labels: Sequence[str], *, ended: bool, path: object
) -> NDArray[np.float64]:
    """Parses the rows of a text file as numbers (n, k).

    Args:
        rows: line number (from 1) and cells of each row.
        labels: names of the k columns.
        ended: whether the file's last line has a line end; if not, a short last row is reported as truncated.
        path: for messages.

    Raises:
        InputError: no rows; a row of another length; a cell that is not a number.
    """
    values = []
    for line, cells in rows:
        broken_off = line == rows[-1][0] and not ended
        check_row_length(len(cells), len(labels), path=path, line=line, broken_off=broken_off)
        values.append(numbers(cells, labels.__getitem__, path=path, line=line))
    if not values:
        raise InputError("no rows of data after the header", where=path, expected="at least one row")
    return np.array(values)


def unknown_name(kind: str, name: str, known: Iterable[str], *, where: object) -> InputError:
    """Makes the error for an unknown `name` of a `kind` ("marker", "column", "unit"), with the closest known names."""
    known = list(known)
    by_lower = {k.lower(): k for k in reversed(known)}
    close = [by_lower[c] for c in difflib.get_close_matches(name.lower(), list(by_lower), n=3, cutoff=0.5)]
    shown = close or known[:12]
    listed = ", ".join(repr(k) for k in shown) + (", ..." if not close and len(known) > len(shown) else "")
    expected = "did you mean " + listed + "?" if close else "one of " + (listed or "(none there)")
    return InputError(f"no {kind} called {name!r}", where=where, expected=expected)


def runs(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """First index and first index after the end, (k, 2), of the runs of True in a mask (n,)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))).reshape(-1, 2)
