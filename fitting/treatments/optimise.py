"""`optimise_treatment`: the smallest treatment that meets stated limits, by a grid over the range, then `refine`.

The grid finds where limits can be met at all, also where outcomes jump (dislocation). With draws from an estimate's
uncertainty the limits must be met for the estimate and, all of them together, for a stated share of the draws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

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
    lower, upper = check_ranges(ranges)
    check_draws(samples, estimate)
    check_confidence(confidence)
    thetas = estimate_and_draws(estimate, samples, seed)
    if isinstance(treatment, str):
        treatment = Treatment.of(treatment, dict.fromkeys(ranges, 0.0))
    search = Search(scene, treatment, tuple(ranges), estimate, wanted, thetas, confidence, dt, threshold)
    axes = [np.linspace(a, b, _GRID[len(ranges)]) for a, b in zip(lower, upper, strict=True)]
    amounts = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    scale = np.maximum(np.abs(lower), np.abs(upper))
    amounts = amounts[np.argsort(np.linalg.norm(amounts / scale, axis=1), kind="stable")]
    options: dict[str, Any] = {"dt": dt, "threshold": threshold, "chunk": CHUNK}

    def report(what: str, before: int, whole: int, done: int, _: int) -> None:
        progress(before + done, whole, what)

    of_range = partial(report, "the whole range", 0, len(amounts))
    coarse = predict(scene, search.treated(amounts), estimate, progress=of_range, **options)
    room = smallest_margin(coarse, wanted)
    fine = np.flatnonzero(room >= 0)
    simulated = len(amounts)

    objection = "" if estimate is None else estimate.objection

    def written(
        met: bool, at: Floats, outcomes: dict[str, float], share: float | None, invalid: str = "", **more: Any
    ) -> TreatmentPlan:
        return TreatmentPlan(
            met and not objection,
            search.treated(at),
            outcomes,
            wanted,
            samples=samples,
            confidence=confidence,
            share=share,
            coverage=(NOT_KNOWN if estimate is None else estimate.coverage).plans,
            simulations=simulated + search.count,  # including those for the share and the outcomes
            invalid="; ".join(why for why in (objection, invalid) if why),
            **more,
        )

    def plan(met: bool, at: Floats) -> TreatmentPlan:
        if coarse["failed"].all():
            none, nearest = dict.fromkeys(MEASURES, np.nan), facts(coarse)["variants"][int(np.argmax(room))]
            flagged = len(ranges) == 1 and any(nearest["status_frames"].values())  # a start's fault is no frame's flag
            trust = {name: nearest[name] for name in ("status", "status_frames")} if flagged else {}
            return written(met, at, none, 0.0 if samples else None, invalid=invalid_variants(coarse), trust=trust)
        share = search.share(at) if samples else None
        return written(met, at, search.outcomes(at), share, trust=search.status(at))

    share_of: dict[int, float] = {}  # of draws that meet the limits, by grid point; 1 without draws

    def found() -> TreatmentPlan:
        nonlocal simulated
        if not fine.size:
            return plan(False, amounts[int(np.argmax(room))])
        for i in range(0, len(fine), _AT_ONCE):
            part = fine[i : i + _AT_ONCE]
            shares = np.ones(len(part))
            if samples:
                draws = 1 + samples
                of_draws: dict[str, Any] = {"samples": samples, "seed": seed}
                of_draws["progress"] = partial(report, "draws", i * draws, len(fine) * draws)
                data = predict(scene, search.treated(amounts[part]), estimate, **options, **of_draws)
                shares = (smallest_margin(data, wanted)[:, 1:] >= 0).mean(axis=1)
                simulated += len(part) * (1 + samples)
            share_of.update(zip(part.tolist(), shares.tolist(), strict=True))
            for k in part[shares >= (confidence if samples else 1.0) - 1e-9]:
                if (search.room(amounts[k]) >= 0).all():  # confirmed by a separate simulation
                    best = amounts[k]
                    if best.any():
                        best = refine(search, best, _next_smaller(amounts, k, lower, upper), lower, upper, scale)
                    return plan(True, best)
        return plan(False, amounts[max(share_of, key=share_of.__getitem__)])

    def so_far() -> TreatmentPlan:
        """The best plan that needs no further simulation."""
        if met := search.met(lower, upper):
            return plan(True, min(met, key=lambda a: effort(a, scale)))
        k = int(fine[0] if fine.size else np.argmax(room))
        if samples and share_of:
            enough = [i for i, share in share_of.items() if share >= confidence - 1e-9]  # the smallest first
            k = enough[0] if enough else max(share_of, key=share_of.__getitem__)
        reached = {name: float(in_si(coarse[name])[k]) for name in MEASURES}
        return written(False, amounts[k], reached, share_of.get(k) if samples else None)

    try:
        return found()
    except KeyboardInterrupt:
        return replace(so_far(), interrupted=True)


def _next_smaller(amounts: Floats, k: int, lower: Floats, upper: Floats) -> Floats:
    """For a single amount, the next smaller grid value on the same side of zero, or the smallest of the range."""
    before = [a for a in amounts[:k] if (a * amounts[k] >= 0).all()]
    return before[-1] if before else np.clip(0.0 * amounts[k], lower, upper)


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
