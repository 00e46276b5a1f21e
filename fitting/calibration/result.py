"""What a calibration found: how often intervals held the truth, how wide they are, and what follows."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from pftwin.base.text_files import write_text

if TYPE_CHECKING:
    from fitting.calibration.plots import CalibrationPlots
    from fitting.trained import TrainedPosterior

Floats = NDArray[np.float64]

FORMAT = "pftwin calibration 1"
LEVELS = (0.5, 0.8, 0.9, 0.95)
_CHECKED = 0.95  # the level on which the verdict is
_SURE = 0.95  # of the intervals of all parameters' shares together that are held against it
_NARROW, _WIDE, _NONE = "too narrow", "wider than need be", "no plant was answered"
_BAD = (_NARROW, _NONE)


class Answers(NamedTuple):
    """Of one kind of plants, those that were answered without a doubt: N of them, d parameters."""

    ranks: Floats  # (N, d) share of the draws below the truth
    errors: Floats  # (N, d) of the means, as a share of the truth
    half_widths: Floats  # (N, d) of 95 % intervals, likewise
    doubted: int  # answered with a doubt: INVALID
    refused: int
    dropped: int  # plants that could not be simulated

    @staticmethod
    def of(rows: list[tuple[Floats, Floats, bool]], dropped: int, refused: int, asked: int) -> Answers:
        """From truth (d,), draws (M, d) and whether there is a doubt, of every answer."""
        clean = [(truth, draws) for truth, draws, doubt in rows if not doubt]
        empty = np.zeros((0, asked))
        ranks = [np.mean(draws < truth, axis=0) for truth, draws in clean]
        errors = [draws.mean(axis=0) / truth - 1 for truth, draws in clean]
        half = [0.5 * np.ptp(np.quantile(d, (0.025, 0.975), axis=0), axis=0) / np.abs(t) for t, d in clean]
        arrays = [np.array(each) if each else empty for each in (ranks, errors, half)]
        return Answers(*arrays, doubted=len(rows) - len(clean), refused=refused, dropped=dropped)

    def held(self, level: float) -> NDArray[np.bool_]:
        """Which (N, d) central intervals of a level hold the truth."""
        return np.abs(self.ranks - 0.5) < 0.5 * level

    @property
    def coverage(self) -> dict[float, Floats]:
        """By level, the share of intervals (d,) that hold the truth."""
        return {level: self.held(level).mean(axis=0) for level in LEVELS}

    @property
    def rms(self) -> Floats:
        """Of the errors (d,)."""
        return np.sqrt(np.mean(self.errors**2, axis=0))

    @property
    def factors(self) -> Floats:
        """By how many times 95 % intervals (d,) would have to be wider to hold as often; 1 where none is too narrow."""
        if _NARROW not in self._words():
            return np.ones(self.ranks.shape[1])
        # So high a quantile that a further plant is held as often (split conformal prediction: Vovk et al. 2005).
        count = len(self.ranks)
        rank = min(np.ceil((count + 1) * _CHECKED) / count, 1.0)
        times = np.quantile(np.abs(self.errors) / self.half_widths, rank, axis=0, method="higher")
        return np.maximum(times, 1.0)

    def verdict(self, names: tuple[str, ...]) -> str:
        """Whether 95 % intervals hold as often as they say, as far as so many plants can tell."""
        if not len(self.ranks):
            return _NONE
        words = self._words()
        listed = {
            word: [name for name, own in zip(names, words, strict=True) if own == word] for word in (_NARROW, _WIDE)
        }
        return "; ".join(f"{word}: {', '.join(named)}" for word, named in listed.items() if named) or "hold"

    def _words(self) -> list[str]:
        """Of each parameter, whether its share may be as large as the level, with room for so many being looked at."""
        found, sure = [], 1 - (1 - _SURE) / max(self.ranks.shape[1], 1)
        for held in self.held(_CHECKED).T:
            share = binomtest(int(held.sum()), len(held)).proportion_ci(sure)
            found.append(_NARROW if share.high < _CHECKED else _WIDE if share.low > _CHECKED else "hold")
        return found


@dataclass(frozen=True, eq=False)
class Calibration:
    """`fitting.calibrate`: answers by the kind of plants."""

    names: tuple[str, ...]
    kinds: dict[str, Answers]
    trained: str  # the posterior, in a sentence
    seed: int
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether no kind of plant shows intervals to be too narrow, and all were answered by some."""
        return not any(a.verdict(self.names).startswith(_BAD) for a in self.kinds.values())

    def sentence(self) -> str:
        """The verdict in a line."""
        if self.holds:
            return "95 % intervals hold on all kinds of plants tried"
        said = {kind: a.verdict(self.names) for kind, a in self.kinds.items()}
        told = "; ".join(f"on {kind} {words}" for kind, words in said.items() if words.startswith(_BAD))
        return f"95 % intervals do NOT hold as often as they say: {told}"

    def widened(self, trained: TrainedPosterior) -> TrainedPosterior:
        """The posterior with answers so wide that their intervals would have held on every kind of plants.

        It is shown by plants of another seed.
        """
        factors = np.max([a.factors for a in self.kinds.values()], axis=0)
        return replace(trained, widened=tuple((factors * (trained.widened or 1.0)).tolist()))

    def rows(self) -> list[tuple[str, ...]]:
        """Of a table: kind of plants, answered of all, share of 95 % intervals that hold, half widths, verdict."""
        found = []
        for kind, a in self.kinds.items():
            of = len(a.ranks) + a.doubted + a.refused + a.dropped
            any_at_all = len(a.ranks) > 0
            held = [f"{100 * x:.0f} %" for x in a.coverage[_CHECKED]] if any_at_all else [""] * len(self.names)
            half = " ".join(f"{100 * x:.2g}" for x in a.half_widths.mean(axis=0)) if any_at_all else ""
            found.append((kind, f"{len(a.ranks)} of {of}", *held, half, a.verdict(self.names)))
        return found

    @property
    def plot(self) -> CalibrationPlots:
        """Figures."""
        from fitting.calibration.plots import CalibrationPlots

        return CalibrationPlots(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        kinds = {
            kind: {
                "answered": len(a.ranks),
                "doubted": a.doubted,
                "refused": a.refused,
                "dropped": a.dropped,
                "coverage": {f"{level:g}": held.tolist() for level, held in a.coverage.items()} if len(a.ranks) else {},
                "rms_error": a.rms.tolist() if len(a.ranks) else [],
                "half_width": a.half_widths.mean(axis=0).tolist() if len(a.ranks) else [],
                "verdict": a.verdict(self.names),
                "ranks": a.ranks.round(4).tolist(),
            }
            for kind, a in self.kinds.items()
        }
        return {
            "format": FORMAT,
            "sentence": self.sentence(),
            "holds": self.holds,
            "names": list(self.names),
            "kinds": kinds,
            "trained": self.trained,
            "synthetic": True,
            "seed": self.seed,
            "seconds": self.seconds,
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes JSON.

        Raises:
            OutputError: it cannot be written.
        """
        target = Path(path)
        write_text(target, json.dumps(self.to_dict(), indent=2) + "\n")
        return target
