"""Section 2.6 of Michaud et al. 2024 on the virtual rig: springs fitted to a pathology, its treatment predicted.

K1, L1, K2 and L2 are fitted to case 2, in which the patella dislocates: by the paper's objective; then with nuisance
parameters (friction, attachments, springs that stiffen), to the same positions, and to one force as well. Case 2 and
its treatment, case 1, are simulated with the results and compared with the measurements, as in the paper's Table 2.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from fitting.demo.straight_springs import PATELLAR_TENDON, QUADRICEPS, StraightSpring, nearest_line, recorded_pulls
from fitting.fit import SPRING_PARAMETERS, fit_tendons
from fitting.parameters import free_parameters
from fitting.training import train_posterior
from pftwin.base.errors import PftwinError
from pftwin.results.tracking import Tracking, find_dislocations, groove_offset

if TYPE_CHECKING:
    from fitting.estimate import Estimate
    from pftwin.model.scene import Scene
    from pftwin.results.metrics import Validation
    from pftwin.results.result import Result

PATHOLOGY, TREATMENT = 2, 1  # cases of the rig
CASES = (PATHOLOGY, TREATMENT)
NOMINAL, PAPERS = "nominal", "paper"
LEARNED = {"positions": ("position",), "force": ("position", "quadriceps")}  # fits by simulations: their channels
FITS = (PAPERS, *LEARNED)
SURFACE = "spline"  # for fits by simulations, as exact as the implant's mesh; the paper's fit uses P5
SIMULATIONS = 8_000  # per fit
STEP = 1e-3  # of the simulations, as in the paper [s]


def _column(*values: float) -> dict[str, float]:
    rows = ("tibial_spring", "femoral_spring", "internal_rotation", "flexion", "tilt", "x", "y", "z", "mean_distance")
    return dict(zip((*rows, "initial_configuration", "real_time_factor"), values, strict=True))


# Michaud et al. 2024, section 3 and Table 2. The table's row of contact forces is missing: we have no values of it.
PAPER = SimpleNamespace(
    errors={"K1": 8.0, "L1": 13.0, "K2": 5.0, "L2": 3.0},  # of the fitted springs, without signs [% of nominal]
    seconds=1233.0,  # time of the fit
    table_2={  # by case, and by the fields of `pftwin.results.metrics.Validation`
        PATHOLOGY: _column(1.12, 2.45, 0.61, 2.07, 3.63, 1.75, 2.22, 0.96, 1.66, 0.75, 4.66),
        TREATMENT: _column(1.16, 2.51, 0.67, 0.88, 5.44, 1.64, 0.87, 2.17, 2.61, 0.73, 3.95),
    },
    outcomes={PATHOLOGY: "dislocates, wedges superiorly and does not re-engage", TREATMENT: "tracks"},
)


class Run(NamedTuple):
    """A simulation of a case with some springs, compared with the measurements of that case."""

    case: int
    result: Result
    validation: Validation
    predicted: Tracking
    measured: Tracking

    @property
    def as_measured(self) -> bool:
        """Whether the patella dislocates and re-engages as it was measured to."""
        one, other = self.predicted, self.measured
        return bool(one.events) == bool(other.events) and one.re_engaged == other.re_engaged


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """Fits, and simulations of both cases with several springs."""

    fits: dict[str, Estimate]  # by name, see `FITS`
    lines: dict[str, StraightSpring]  # straight lines nearest to the plant's springs, by spring
    runs: dict[str, dict[int, Run]]  # by springs and case

    @property
    def nominal(self) -> np.ndarray:
        """K1, L1, K2, L2 as published."""
        return self.fits[PAPERS].nominal

    @property
    def line(self) -> np.ndarray:
        """K1, L1, K2, L2 of the straight lines."""
        return np.array([v for name in (QUADRICEPS, PATELLAR_TENDON) for v in self.lines[name][:2]])

    def errors(self, fit: str, truth: np.ndarray) -> np.ndarray:
        """Errors of a fit's springs from others (4,) [%]."""
        return 100 * (self.fits[fit].values[: self.fits[fit].asked] / truth - 1)


def paper_study(
    *,
    dt: float = STEP,
    simulations: int = SIMULATIONS,
    progress: Callable[[float, int, str], None] = lambda done, of, what: None,
    **options: Any,
) -> PaperStudy:
    """Fits case 2 by the paper's objective and by simulations, and simulates cases 2 and 1 with the results.

    `dt` is the time step [s], `progress` is called with the number of steps of this work done, of all, and what comes
    next, and options are those of `fit_tendons`, such as `starts` and `seed`. Raises PftwinError for an INVALID motion.
    """
    from pftwin import rig

    of = 2 + 2 * len(LEARNED)

    def learned(k: int, fit: str) -> Estimate:
        """The k-th fit by simulations, which are a step of the work, and so is learning from them."""
        letter, before = "BC"[k], 1 + 2 * k

        def tell(done: int, whole: int) -> None:
            words = f"simulating {whole:,} knees" if done < whole else f"learning from {whole:,} knees"
            progress(before + done / whole, of, f"fit {letter}: {words}")

        tell(0, simulations)
        return learned_fit(fit, simulations, tell)

    progress(0, of, "fit A: by the paper's objective")
    scene, measured = rig.case(PATHOLOGY), rig.measured(PATHOLOGY)
    found = fit_tendons(scene, measured, objective="paper", free=SPRING_PARAMETERS, **options)
    if found.reason.startswith("interrupted"):
        raise KeyboardInterrupt
    fits = {PAPERS: found} | {fit: learned(k, fit) for k, fit in enumerate(LEARNED)}
    lines = {name: nearest_line(pull) for name, pull in recorded_pulls(PATHOLOGY).items()}
    progress(of - 1, of, f"simulating cases {PATHOLOGY} and {TREATMENT}")
    alone = {PAPERS: found.values, NOMINAL: found.nominal}
    runs = {s: {n: simulated(n, s, with_springs(rig.case(n), theta), dt) for n in CASES} for s, theta in alone.items()}
    for fit in LEARNED:
        knees = {n: fits[fit].apply(rig.case(n, contact=SURFACE)) for n in CASES}
        runs[fit] = {n: simulated(n, fit, knee, dt) for n, knee in knees.items()}
    return PaperStudy(fits, lines, runs)


def learned_fit(fit: str, simulations: int, progress: Callable[[int, int], None]) -> Estimate:
    """Posterior of case 2's springs and nuisance parameters, from simulated knees; its time includes training and
    compiling. `progress`: see `train_posterior`."""
    from pftwin import rig

    used, began = LEARNED[fit], time.perf_counter()
    scene, measured = rig.case(PATHOLOGY, contact=SURFACE), rig.measured(PATHOLOGY)
    trained = train_posterior(scene, measured, use=used, nuisance="rig", simulations=simulations, progress=progress)
    found = trained.estimate(scene, measured)
    return replace(found, seconds=time.perf_counter() - began)


def with_springs(scene: Scene, theta: np.ndarray) -> Scene:
    """The scene with K1, L1, K2, L2 = theta (4,) [N/m, m]. Raises InputError for values that no spring can have."""
    return free_parameters(scene, SPRING_PARAMETERS).apply(scene, jnp.asarray(theta, dtype=float))


def simulated(case: int, springs: str, scene: Scene, dt: float = STEP) -> Run:
    """Simulates a case of the rig with these springs and compares it with its measurements. Raises PftwinError for an
    INVALID motion."""
    from pftwin import LinearImplicit, rig, simulate, validate

    measured = rig.measured(case)
    result = simulate(scene, integrator=LinearImplicit(), dt=dt)  # the integrator of fits and predictions
    predicted = result.dislocations()
    if predicted is None:
        raise PftwinError(f"{result.tracking} (case {case}, springs: {springs})")
    assert result.surface is not None
    _, offset = groove_offset(result.surface, measured.center)
    observed = find_dislocations(measured.times, offset, result.knee.flexion)
    return Run(case, result, validate(result, measured), predicted, observed)
