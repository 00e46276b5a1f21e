"""`optimise_treatment`: the smallest treatment that meets stated limits, by a grid over the range, then `refine`.

The grid finds where limits can be met at all, also where outcomes jump (dislocation). With draws from an estimate's
uncertainty the limits must be met for the estimate and, all of them together, for a stated share of the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fitting.coverage import NOT_KNOWN
from fitting.prediction.outcomes import MEASURES
from fitting.prediction.plots import facts, invalid_variants
from fitting.prediction.predicting import Fitted, check_draws, estimate_and_draws, predict
from fitting.treatments import Treatment
from fitting.treatments.limits import Limit, TreatmentPlan, in_si, smallest_margin
from fitting.treatments.refine import CHUNK, Search, effort, refine
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene
from pftwin.results.tracking import DISLOCATED

if TYPE_CHECKING:
    from xarray import Dataset

_GRID = {1: 41, 2: 15, 3: 8}  # grid points per side, by the number of amounts
_AT_ONCE = 8  # grid points whose draws are simulated in one batch


def optimise_treatment(
    scene: Scene,
    limits: Limit | Sequence[Limit],
    ranges: Mapping[str, tuple[float, float]] | None = None,
    treatment: str | Treatment = "tibial_tuberosity_transfer",
    estimate: Fitted | None = None,
    *,
    samples: int = 0,
    confidence: float = 0.9,
    seed: int = 0,
    dt: float | None = None,
    threshold: float = DISLOCATED,
    progress: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> TreatmentPlan:
    """Finds the smallest treatment that meets the limits.

        optimise_treatment(scene, Limit("dislocation_margin", at_least=0.003), {"medialisation": (0.0, 0.020)})

    Size is the root of the sum of squares of the amounts, each as a share of the larger end of its range.

    Args:
        scene: the untreated scene.
        limits: limits, all of which must be met.
        ranges: (least, most) of one to three amounts, SI units, by name; other amounts keep the treatment's values. By
            default medialisation from 0 to 20 mm.
        treatment: a kind, or a treatment that has these amounts.
        estimate: parameters that replace the scene's own.
        samples: draws from the estimate's uncertainty.
        confidence: share of the draws that must meet all limits, in addition to the estimate itself; a draw that cannot
            be simulated meets none.
        seed: of the draws.
        dt: longest time step [s]; by default as in `predict`.
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].
        progress: called with the number of simulations done, of all, and the stage: the whole range, or the draws.

    Returns:
        A plan, with the share of draws that meet its limits. If no amount within the range meets the limits, it says so
        and contains the nearest. After an interrupt (Ctrl-C) it is the best so far, and says so.

    Raises:
        InputError: no limits, empty ranges, more than three amounts, a scene that lacks what is to be changed; samples
            without an estimate; a confidence that is no share.
        KeyboardInterrupt: interrupted before the whole range was simulated.
    """
    wanted = (limits,) if isinstance(limits, Limit) else tuple(limits)
    ranges = dict(ranges or {"medialisation": (0.0, 0.020)})
    check_limits(wanted)
    ends = check_ranges(ranges)
    check_draws(samples, estimate)
    check_confidence(confidence)
    thetas = estimate_and_draws(estimate, samples, seed)
    if isinstance(treatment, str):
        treatment = Treatment.of(treatment, dict.fromkeys(ranges, 0.0))
    search = Search(scene, treatment, tuple(ranges), estimate, wanted, thetas, confidence, dt, threshold)
    options = {"dt": dt, "threshold": threshold, "chunk": CHUNK}
    grid = _GridSearch(scene, search, wanted, estimate, ends, samples, confidence, seed, options, progress)
    try:
        return grid.best()
    except KeyboardInterrupt:
        return replace(grid.best_so_far(), interrupted=True)


@dataclass(eq=False)
class _GridSearch:
    """Simulates a grid over the whole range, then draws at its points that meet the limits, smallest amounts first."""

    scene: Scene
    search: Search
    limits: tuple[Limit, ...]
    estimate: Fitted | None
    ends: tuple[Floats, Floats]  # lower and upper, of each amount's range
    samples: int
    confidence: float
    seed: int
    options: dict[str, Any]  # of `predict`
    progress: Callable[[int, int, str], None]

    def __post_init__(self) -> None:
        axes = [np.linspace(a, b, _GRID[len(self.ends[0])]) for a, b in zip(*self.ends, strict=True)]
        amounts = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
        self.scale = np.maximum(*np.abs(self.ends))
        self.amounts = amounts[np.argsort(np.linalg.norm(amounts / self.scale, axis=1), kind="stable")]
        self.shares: dict[int, float] = {}  # of draws that meet the limits, by grid point; 1 without draws
        self.simulated = 0
        self.coarse = self._predicted(self.amounts, "the whole range", 0, len(amounts))
        self.margins = smallest_margin(self.coarse, self.limits)
        self.candidates = np.flatnonzero(self.margins >= 0)

    def best(self) -> TreatmentPlan:
        """The smallest treatment that meets the limits; if none does, the nearest on the grid."""
        for i in range(0, len(self.candidates), _AT_ONCE):
            part = self.candidates[i : i + _AT_ONCE]
            shares = self._shares_of_draws(part, i) if self.samples else np.ones(len(part))
            self.shares.update(zip(part.tolist(), shares.tolist(), strict=True))
            for k in part[shares >= (self.confidence if self.samples else 1.0) - 1e-9]:
                if (self.search.room(self.amounts[k]) >= 0).all():  # confirmed by a separate simulation
                    best = self.amounts[k]
                    if best.any():
                        best = refine(self.search, best, self._next_smaller(k), *self.ends, self.scale)
                    return self._simulated_plan(True, best)
        k = max(self.shares, key=self.shares.__getitem__) if self.shares else int(np.argmax(self.margins))
        return self._simulated_plan(False, self.amounts[k])

    def best_so_far(self) -> TreatmentPlan:
        """The best plan that needs no further simulation."""
        if met := self.search.met(*self.ends):
            return self._simulated_plan(True, min(met, key=lambda a: effort(a, self.scale)))
        k = int(self.candidates[0] if self.candidates.size else np.argmax(self.margins))
        if self.samples and self.shares:
            enough = [i for i, share in self.shares.items() if share >= self.confidence - 1e-9]  # the smallest first
            k = enough[0] if enough else max(self.shares, key=self.shares.__getitem__)
        outcomes = {name: float(in_si(self.coarse[name])[k]) for name in MEASURES}
        return self._plan(False, self.amounts[k], outcomes, self.shares.get(k) if self.samples else None)

    def _predicted(self, amounts: Floats, stage: str, before: int, whole: int, **more: Any) -> Dataset:
        """Outcomes at these amounts (n, k); `before` of `whole` simulations of the stage are done."""

        def report(done: int, _: int) -> None:
            self.progress(before + done, whole, stage)

        data = predict(self.scene, self.search.treated(amounts), self.estimate, progress=report, **self.options, **more)
        self.simulated += len(amounts) * (1 + more.get("samples", 0))
        return data

    def _shares_of_draws(self, points: NDArray[np.intp], before: int) -> Floats:
        """Share of draws that meet the limits at each of these grid points; draws at `before` points are done."""
        done, whole = (n * (1 + self.samples) for n in (before, len(self.candidates)))
        data = self._predicted(self.amounts[points], "draws", done, whole, samples=self.samples, seed=self.seed)
        return (smallest_margin(data, self.limits)[:, 1:] >= 0).mean(axis=1)

    def _next_smaller(self, k: int) -> Floats:
        """For a single amount, the next smaller grid value on the same side of zero, or the smallest of the range."""
        smaller = [a for a in self.amounts[:k] if (a * self.amounts[k] >= 0).all()]
        return smaller[-1] if smaller else np.clip(0.0 * self.amounts[k], *self.ends)

    def _simulated_plan(self, met: bool, at: Floats) -> TreatmentPlan:
        """The plan with these amounts, whose outcomes are simulated unless the whole grid failed."""
        if not self.coarse["failed"].all():
            share = self.search.share(at) if self.samples else None
            return self._plan(met, at, self.search.outcomes(at), share, trust=self.search.status(at))
        none, nearest = dict.fromkeys(MEASURES, np.nan), facts(self.coarse)["variants"][int(np.argmax(self.margins))]
        flagged = len(at) == 1 and any(nearest["status_frames"].values())  # a start's fault is no frame's flag
        trust = {name: nearest[name] for name in ("status", "status_frames")} if flagged else {}
        share = 0.0 if self.samples else None
        return self._plan(met, at, none, share, invalid=invalid_variants(self.coarse), trust=trust)

    def _plan(
        self, met: bool, at: Floats, outcomes: dict[str, float], share: float | None, invalid: str = "", **more: Any
    ) -> TreatmentPlan:
        objection = "" if self.estimate is None else self.estimate.objection
        return TreatmentPlan(
            met and not objection,
            self.search.treated(at),
            outcomes,
            self.limits,
            samples=self.samples,
            confidence=self.confidence,
            share=share,
            coverage=(NOT_KNOWN if self.estimate is None else self.estimate.coverage).plans,
            simulations=self.simulated + self.search.count,  # including those for the share and the outcomes
            invalid="; ".join(why for why in (objection, invalid) if why),
            **more,
        )


def check_confidence(confidence: float) -> None:
    """Raises InputError unless the confidence is a number above 0 and at most 1."""
    if not (isinstance(confidence, int | float) and 0 < confidence <= 1):
        expected = "a share above 0 and up to 1, such as 0.9"
        raise InputError(f"found {confidence!r}", where="confidence", expected=expected)


def check_limits(limits: Sequence[Limit]) -> None:
    """Raises InputError if there are no limits, or one of them is not a `Limit`."""
    if not limits or not all(isinstance(lim, Limit) for lim in limits):
        expected = 'limits such as Limit("largest_offset", at_most=0.01)'
        raise InputError(f"found {limits!r}", where="limits", expected=expected)


def check_ranges(ranges: Mapping[str, tuple[float, float]]) -> tuple[Floats, Floats]:
    """Lower and upper ends (k,) of all ranges. Raises InputError for more than three, or an invalid range."""
    if len(ranges) > max(_GRID):
        raise InputError(f"{len(ranges)} amounts", where="ranges", expected=f"at most {max(_GRID)}")
    for name, pair in ranges.items():
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError):
            low = high = np.nan
        if not low < high or not np.isfinite([low, high]).all():
            raise InputError(f"found {pair!r}", where=f"ranges: {name}", expected="(least, most), in SI units")
    low, high = np.array([[float(a), float(b)] for a, b in ranges.values()]).T
    return low, high
