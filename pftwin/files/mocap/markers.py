"""Marker trajectories: positions of named points over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import refuse_repeated
from pftwin.files.mocap.tables import Sampled, uniform_times, unknown_name


@dataclass(frozen=True, eq=False)
class MarkerTrajectories(Sampled):
    """Positions of m markers at n evenly spaced times.

    Args:
        times: (n,) seconds, strictly increasing and evenly spaced; rounding of printed times is taken out.
        names: m marker names, each once.
        positions: (n, m, 3) metres; NaN where a marker is missing (all three coordinates together).
        source: where the data come from, for messages.

    Raises:
        InputError: uneven, repeated or unsorted times (naming the row), shapes that do not match, repeated names.
    """

    times: NDArray[np.float64]
    names: tuple[str, ...]
    positions: NDArray[np.float64]
    source: str = "markers"

    def __post_init__(self) -> None:
        times = uniform_times(self.times, where=self.source)
        positions = np.array(self.positions, dtype=np.float64)
        names = tuple(self.names)
        if positions.shape != (times.size, len(names), 3):
            raise InputError(
                f"positions of shape {positions.shape}",
                where=self.source,
                expected=f"{(times.size, len(names), 3)} for {times.size} times and {len(names)} names",
            )
        refuse_repeated(names, "marker names", where=self.source)
        if (bad := np.argwhere(np.isinf(positions).any(axis=-1))).size:
            frame, marker = bad[0]
            raise InputError(
                f"marker {names[marker]!r} is infinite on row {frame + 1}", where=self.source, expected="finite or NaN"
            )
        positions[np.isnan(positions).any(axis=-1)] = np.nan
        for field, value in (("times", times), ("names", names), ("positions", positions)):
            object.__setattr__(self, field, value)

    @property
    def missing(self) -> NDArray[np.bool_]:
        """(n, m): where a marker was not seen."""
        return np.isnan(self.positions[..., 0])

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise unknown_name("marker", name, self.names, where=self.source)
        return self.names.index(name)

    def marker(self, name: str) -> NDArray[np.float64]:
        """Trajectory (n, 3) [m] of one marker; an unknown name is an InputError that offers the nearest known ones."""
        return self.positions[:, self._index(name)]

    def select(self, names: Sequence[str]) -> MarkerTrajectories:
        """The named markers only, in that order."""
        index = [self._index(name) for name in names]
        return replace(self, names=tuple(names), positions=self.positions[:, index])

    def with_positions(self, positions: ArrayLike) -> MarkerTrajectories:
        """The same markers and times with other positions (n, m, 3) [m], filtered ones for instance."""
        return replace(self, positions=np.asarray(positions, dtype=np.float64))

    def rename(self, names: Mapping[str, str]) -> MarkerTrajectories:
        """Markers renamed by {old: new}."""
        for old in names:
            self._index(old)
        return replace(self, names=tuple(names.get(n, n) for n in self.names))


def zeros_to_missing(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (n, m, 3) with every triple of exact zeros turned to NaN.

    Several systems write a marker that was not seen as 0 0 0 (or -0 0 0); no real marker rests on the laboratory's
    origin to the last digit.
    """
    out = positions.copy()
    out[(out == 0).all(axis=-1)] = np.nan
    return out
