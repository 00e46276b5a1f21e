"""A table of signals over time: forces, lengths, angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.markers import frames_between
from pftwin.files.mocap.naming import quoted, unknown_name
from pftwin.files.mocap.timebase import increasing_times, sampling_rate


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
