"""Results of a calibration: coverage and width of intervals, and verdicts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from fitting.calibration.operations import OUTCOMES, OperationOutcome
from fitting.prediction.outcomes import MEASURES
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.quantities import as_read
from pftwin.base.text_files import write_json_file

if TYPE_CHECKING:
    from fitting.calibration.plots import CalibrationPlots
    from fitting.calibration.quick_fit import QuickFit
    from fitting.trained import TrainedPosterior

Calibrated = TypeVar("Calibrated", bound="TrainedPosterior | QuickFit")

FORMAT = "pftwin calibration 1"
LEVELS = (0.5, 0.8, 0.9, 0.95)
INTERVALS, BANDS = 0.95, 0.9  # nominal levels that are judged: of parameters' intervals, of predicted bands
TO_WIDEN = 19  # fewest answers of each kind: a further error exceeds the largest of n with probability 1 / (n + 1)
_SURE = 0.95  # joint confidence of the intervals of all parameters' coverage that are compared with the level
_LEAST_TOLD = 0.5  # plants are too few if even full coverage of them does not exclude this coverage
_MOST_RUN = 0.5  # least share of draws that must run for a prediction to count
_AS_STATED, _NARROW, _WIDE = "as stated", "too narrow", "wider than necessary"
_NONE, _FEW = "no valid answer for any plant", "too few plants to tell"
_UNSAFE, _NO_PLAN = "less safe than stated", "no plan was found"
_BAD = (_NARROW, _NONE, _FEW, _UNSAFE, _NO_PLAN)


class Answers(NamedTuple):
    """Answers for the plants of one kind that were answered without a doubt: N plants, d parameters or outcomes."""

    ranks: Floats  # (N, d) share of the draws below the true value
    errors: Floats  # (N, d) of the means; of parameters as a share of the true value
    half_widths: Floats  # (N, d) of intervals of the level, in the same unit
    doubted: int  # number answered with a doubt: INVALID
    refused: int
    dropped: int  # plants that could not be simulated
    level: float = INTERVALS  # nominal level that is judged

    @staticmethod
    def of(rows: list[tuple[Floats, Floats, bool]], dropped: int, refused: int, asked: int) -> Answers:
        """For parameters: from truth (d,), draws (M, d) and whether there is a doubt, for every answer."""
        clean = [(truth, draws, np.abs(truth)) for truth, draws, doubt in rows if not doubt]
        return _answers(clean, asked, INTERVALS)._replace(
            doubted=len(rows) - len(clean), refused=refused, dropped=dropped
        )

    @staticmethod
    def of_predictions(rows: Sequence[OperationOutcome], names: Sequence[str]) -> Answers:
        """For outcomes after a treatment, where one was found. Plants without outcomes count as dropped, and those of
        which most draws cannot be simulated as doubted."""
        treated = [row for row in rows if row.met is not False]
        some = [row for row in treated if np.isfinite(row.truth).all()]
        clean = [(row.truth, row.draws, np.ones(len(names))) for row in some if row.share >= _MOST_RUN]
        answers = _answers(clean, len(names), BANDS)
        return answers._replace(doubted=len(some) - len(clean), dropped=len(treated) - len(some))

    def covered(self, level: float) -> NDArray[np.bool_]:
        """Which (N, d) central intervals of a level contain the true value."""
        return np.abs(self.ranks - 0.5) < 0.5 * level

    @property
    def coverage(self) -> dict[float, Floats]:
        """Coverage (d,): share of intervals that contain the true value, by level."""
        return {level: self.covered(level).mean(axis=0) for level in LEVELS}

    @property
    def rms(self) -> Floats:
        """RMS errors (d,)."""
        return np.sqrt(np.mean(self.errors**2, axis=0))

    @property
    def factors(self) -> Floats:
        """Factors (d,), at least 1, with which each interval, symmetric about its mean, contains the true value of a
        further plant with the nominal probability: a quantile of the errors (split conformal: Vovk et al. 2005)."""
        count = len(self.ranks)
        rank = min(int(np.ceil((count + 1) * self.level)), count)
        with np.errstate(divide="ignore", invalid="ignore"):  # infinite where an interval has no width
            times = np.sort(np.abs(self.errors) / self.half_widths, axis=0)
        return np.maximum(times[rank - 1], 1.0)

    def verdict(self, names: tuple[str, ...]) -> str:
        """Whether intervals reach their nominal coverage, as far as the number of plants can show."""
        if not len(self.ranks):
            return _NONE
        words = self._verdicts()
        if _FEW in words:
            return _FEW
        listed = {
            word: [name for name, own in zip(names, words, strict=True) if own == word] for word in (_NARROW, _WIDE)
        }
        return "; ".join(f"{word}: {', '.join(named)}" for word, named in listed.items() if named) or _AS_STATED

    @property
    def _few(self) -> bool:
        """Whether there are so few plants that even full coverage would show next to nothing."""
        count = len(self.ranks)
        return bool(binomtest(count, count).proportion_ci(_SURE).low < _LEAST_TOLD)

    def _verdicts(self) -> list[str]:
        """Verdict for each parameter, from a binomial interval of its coverage, corrected for their number."""
        found, sure = [], 1 - (1 - _SURE) / max(self.ranks.shape[1], 1)
        for covered in self.covered(self.level).T:
            share = binomtest(int(covered.sum()), len(covered)).proportion_ci(sure)
            found.append(_NARROW if share.high < self.level else _WIDE if share.low > self.level else _AS_STATED)
        return [_FEW] * len(found) if self._few and _NARROW not in found else found

    def column(self, names: tuple[str, ...], scales: Floats) -> tuple[str, ...]:
        """A table's column: answered of all; coverage and half width for each name; verdict."""
        of = len(self.ranks) + self.doubted + self.refused + self.dropped
        cells, words = [""] * len(names), [self.verdict(names)]
        if len(self.ranks):
            coverages, half = self.coverage[self.level], scales * self.half_widths.mean(axis=0)
            cells = [f"{100 * coverage:.0f} %, {width:.2g}" for coverage, width in zip(coverages, half, strict=True)]
            words = [word for word in (_NARROW, _WIDE, _FEW) if word in self._verdicts()] or [_AS_STATED]
        return f"{len(self.ranks)} of {of}", *cells, "; ".join(words)

    def to_dict(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Plain values, for JSON."""
        some = len(self.ranks) > 0
        return {
            "answered": len(self.ranks),
            "doubted": self.doubted,
            "refused": self.refused,
            "dropped": self.dropped,
            "coverage": {f"{level:g}": each.tolist() for level, each in self.coverage.items()} if some else {},
            "rms_error": self.rms.tolist() if some else [],
            "half_width": self.half_widths.mean(axis=0).tolist() if some else [],
            "verdict": self.verdict(names),
            "ranks": self.ranks.round(4).tolist(),
        }


def _answers(clean: Sequence[tuple[Floats, Floats, Floats]], asked: int, level: float) -> Answers:
    """From truth (d,), draws (M, d) and the units (d,) of errors, for every answer."""
    ends, empty = (0.5 * (1 - level), 0.5 * (1 + level)), np.zeros((0, asked))
    ranks = [np.mean(draws < truth, axis=0) for truth, draws, _ in clean]
    errors = [(draws.mean(axis=0) - truth) / unit for truth, draws, unit in clean]
    half = [0.5 * np.ptp(np.quantile(draws, ends, axis=0), axis=0) / unit for _, draws, unit in clean]
    arrays = [np.array(each) if each else empty for each in (ranks, errors, half)]
    return Answers(*arrays, doubted=0, refused=0, dropped=0, level=level)


class Plans(NamedTuple):
    """For one kind of plants: number of treatments found, and of those that meet their limits in the plant."""

    safe: int
    found: int
    asked: int  # plants for which one was searched
    confidence: float

    @staticmethod
    def of(rows: Sequence[OperationOutcome], confidence: float) -> Plans:
        """Counts the plans of all plants."""
        found = [row.safe for row in rows if row.met]
        return Plans(sum(bool(s) for s in found), len(found), len(rows), confidence)

    def verdict(self) -> str:
        """Whether enough of them are safe, as far as the number of plants can show."""
        if not self.found:
            return _NO_PLAN
        high = binomtest(self.safe, self.found).proportion_ci(_SURE).high
        return _UNSAFE if high < self.confidence else _AS_STATED


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of `fitting.calibrate`: answers by kind of plants."""

    names: tuple[str, ...]
    kinds: dict[str, Answers]
    trained: str  # description of the posterior
    seed: int
    seconds: float
    operation: str = ""  # what was predicted, in words
    predictions: dict[str, Answers] = field(default_factory=dict)  # of `OUTCOMES`, SI units
    plans: dict[str, Plans] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether on every kind enough plants are answered, no interval is too narrow, and plans are found and safe."""
        return not self._failing()

    def _failing(self) -> list[str]:
        """Verdicts that fail, in words."""
        said = {f"95 % intervals on {kind}": a.verdict(self.names) for kind, a in self.kinds.items()}
        said |= {f"90 % bands on {kind}": a.verdict(OUTCOMES) for kind, a in self.predictions.items()}
        said |= {f"plans on {kind}": p.verdict() for kind, p in self.plans.items()}
        return [f"{what}: {words}" for what, words in said.items() if words.startswith(_BAD)]

    def sentence(self) -> str:
        """The verdict in a line."""
        what = "95 % intervals" + (" and 90 % bands" if self.predictions else "") + (" and plans" if self.plans else "")
        if self.holds:
            return f"{what} are as reliable as stated on all kinds of plants tried"
        return f"{what} are NOT shown to be as reliable as stated: {'; '.join(self._failing())}"

    def widened(self, calibrated: Calibrated) -> Calibrated:
        """What was calibrated, widened so that its intervals would have contained the true value on every kind of
        plants. Check it on plants of another seed.

        Raises:
            InputError: too few valid answers for some kind.
        """
        for kind, answers in self.kinds.items():
            if len(answers.ranks) < TO_WIDEN:
                found = f"{len(answers.ranks)} valid answers for plants {kind!r}"
                raise InputError(
                    found, where="widen", expected=f"at least {TO_WIDEN} of each kind", remedy="more plants"
                )
        factors = np.max([a.factors for a in self.kinds.values()], axis=0) * (calibrated.widened or 1.0)
        if endless := [name for name, times in zip(self.names, factors, strict=True) if not np.isfinite(times)]:
            raise InputError(f"intervals of {', '.join(endless)} have no width", where="widen")
        plants = {kind: len(answers.ranks) for kind, answers in self.kinds.items()}
        return replace(calibrated, widened=tuple(factors.tolist()), plants=plants)

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of a table of intervals, a column for each kind: see `Answers.column`; half widths in per cent."""
        return _table(self.kinds, self.names, [f"{name} [%]" for name in self.names], 100.0 * np.ones(len(self.names)))

    def prediction_rows(self) -> list[tuple[str, ...]]:
        """Rows of a table of bands; half widths in the units shown: mm, degrees, newtons and per cent."""
        read = [as_read(MEASURES[name].unit, percent=True) for name in OUTCOMES]
        words = [f"{name.replace('_', ' ')} [{unit}]" for name, (_, unit) in zip(OUTCOMES, read, strict=True)]
        return _table(self.predictions, OUTCOMES, words, np.array([scale for scale, _ in read]))

    def plan_rows(self) -> list[tuple[str, ...]]:
        """Rows of a table of plans, a column for each kind: found of all, safe of those, verdict."""
        cells = [(f"{p.found} of {p.asked}", f"{p.safe} of {p.found}", p.verdict()) for p in self.plans.values()]
        return list(zip(("found", "safe in the plant", "verdict"), *cells, strict=True))

    @property
    def plot(self) -> CalibrationPlots:
        """Figures of this calibration."""
        from fitting.calibration.plots import CalibrationPlots

        return CalibrationPlots(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "format": FORMAT,
            "sentence": self.sentence(),
            "holds": self.holds,
            "names": list(self.names),
            "kinds": {kind: a.to_dict(self.names) for kind, a in self.kinds.items()},
            "operation": self.operation,
            "outcomes": list(OUTCOMES),
            "predictions": {kind: a.to_dict(OUTCOMES) for kind, a in self.predictions.items()},
            "plans": {kind: {**p._asdict(), "verdict": p.verdict()} for kind, p in self.plans.items()},
            "trained": self.trained,
            "synthetic": True,
            "seed": self.seed,
            "seconds": self.seconds,
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a JSON file.

        Raises:
            OutputError: if it cannot be written.
        """
        target = Path(path)
        write_json_file(target, self.to_dict())
        return target


def _table(
    kinds: dict[str, Answers], names: tuple[str, ...], words: list[str], scales: Floats
) -> list[tuple[str, ...]]:
    columns = [answers.column(names, scales) for answers in kinds.values()]
    return list(zip(("answered", *words, "verdict"), *columns, strict=True))
