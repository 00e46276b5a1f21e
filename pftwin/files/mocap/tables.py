"""A table of signals over time: forces, lengths, angles.

Unknown names: an error that offers the nearest known ones.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.timebase import frames_between, increasing_times, sampling_rate


@dataclass(frozen=True, eq=False)
class Table:
    """k named columns at n times, in SI units.

    Args:
        times: (n,) seconds, strictly increasing. They may be uneven (results of adaptive integrators are); `rate`
            refuses those that are.
        names: k column names, each once.
        values: (n, k); NaN where a cell was empty.
        units: unit of each column by name ("m", "rad", "N", "1", or "" where the file does not tell).
        source: where the data come from, for messages.
        in_degrees: the flag of an OpenSim file, as it stood there; None for other files.

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
        times = increasing_times(self.times, where=self.source)
        values = np.array(self.values, dtype=np.float64)
        names = tuple(self.names)
        if values.shape != (times.size, len(names)):
            raise InputError(
                f"values of shape {values.shape}",
                where=self.source,
                expected=f"{(times.size, len(names))} for {times.size} times and {len(names)} names",
            )
        if repeated := sorted({n for n in names if names.count(n) > 1}):
            raise InputError(f"columns that occur twice: {quoted(repeated)}", where=self.source, expected="each once")
        units = {name: self.units.get(name, "") for name in names}
        for attribute, value in (("times", times), ("names", names), ("values", values), ("units", units)):
            object.__setattr__(self, attribute, value)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]; uneven times are an InputError."""
        return sampling_rate(self.times, where=self.source)

    def column(self, name: str) -> NDArray[np.float64]:
        """One column (n,); an unknown name is an InputError that offers the nearest known ones."""
        if name not in self.names:
            raise unknown_name("column", name, self.names, where=self.source)
        return self.values[:, self.names.index(name)]

    def select(self, names: Sequence[str]) -> Table:
        """The named columns only, in that order."""
        values = np.stack([self.column(name) for name in names], axis=1)
        return replace(self, names=tuple(names), values=values)

    def between(self, start: float, end: float) -> Table:
        """The rows with start <= t <= end [s]; none of them is an InputError."""
        keep = frames_between(self.times, start, end, where=self.source)
        return replace(self, times=self.times[keep], values=self.values[keep])


def unknown_name(kind: str, name: str, known: Iterable[str], *, where: object) -> InputError:
    """The error for a `kind` ("marker", "column", "unit") called `name` that is not among `known`."""
    known = list(known)
    by_lower = {k.lower(): k for k in reversed(known)}
    close = [by_lower[c] for c in difflib.get_close_matches(name.lower(), list(by_lower), n=3, cutoff=0.5)]
    shown = close or known[:12]
    listed = ", ".join(repr(k) for k in shown) + (", ..." if not close and len(known) > len(shown) else "")
    lead = "did you mean " + listed + "?" if close else "one of " + (listed or "(none there)")
    return InputError(f"no {kind} called {name!r}", where=where, expected=lead)


def quoted(names: Iterable[object], limit: int = 8) -> str:
    """A readable list of the first `limit` names."""
    items = [str(n) for n in names]
    tail = f" and {len(items) - limit} more" if len(items) > limit else ""
    return ", ".join(items[:limit]) + tail
