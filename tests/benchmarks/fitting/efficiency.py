"""How near fits come to the best that any estimator could do, on data of the twin itself with marker noise alone.

The bound is Cramer and Rao's: the inverse of the Fisher information at the true springs. The data are the twin's motion
with springs that differ from those where the search begins, and white noise of the rig's markers on every coordinate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fitting.evaluation import Evaluator, Prediction
from fitting.fit import SPRING_PARAMETERS, fit_tendons
from fitting.objective import SPRINGS, Objective
from fitting.parameters import free_parameters
from fitting.programs import POSITION
from fitting.uncertainty import NORMAL_95, inverse_information
from pftwin.base.arrays import Floats
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene
from tests.benchmarks.row import Row
from tests.verification.rig_plant.laboratory import FORCE_NOISE, MARKER_NOISE

TRUE = np.array([1.10, 0.97, 0.92, 1.02])  # true springs, as multiples of the nominal ones
MOTIONS = {"case 2, which dislocates": 2, "case 1, which tracks": 1}
OVER_BOUND = 1.25
PERCENT = 1.0
SPRING = SPRINGS["femoral"]  # whose force is measured as well
_SHORT = 8  # times as many steps as a fit begins its answer with: the motion that is measured


class Kind(NamedTuple):
    """What is measured, and by which objective it is fitted."""

    name: str
    objective: str
    use: tuple[str, ...]


KINDS = (
    Kind("positions, likelihood", "likelihood", (POSITION,)),
    Kind("positions and one spring force, likelihood", "likelihood", (POSITION, SPRING)),
    Kind("positions, paper's objective", "paper", (POSITION,)),
)


@dataclass(frozen=True, eq=False)
class Found:
    """Repeated fits of one kind: estimates and standard deviations (seeds, p), the truth (p,), the bound (p, p)."""

    values: Floats
    deviations: Floats
    true: Floats
    bound: Floats

    @property
    def errors(self) -> Floats:
        """Relative root mean square errors (p,)."""
        return _rms(self.values / self.true - 1)

    @property
    def relative_bound(self) -> Floats:
        """Smallest relative standard deviations (p,)."""
        return np.sqrt(np.diagonal(self.bound)) / self.true

    @property
    def ratio_error(self) -> float:
        """Of K1/K2, relative."""
        ratio = self.values[:, 0] / self.values[:, 2]
        return float(_rms(ratio / (self.true[0] / self.true[2]) - 1))

    @property
    def coverage(self) -> Floats:
        """Share of 95 % intervals that contain the true value (p,)."""
        return np.mean(np.abs(self.values - self.true) <= NORMAL_95 * self.deviations, axis=0)


def rows(seeds: int) -> list[Row]:
    """Both motions, so many seeds of each."""
    import pftwin

    out = []
    for name, case in MOTIONS.items():
        out += rows_of(name, repeated(pftwin.rig.case(case), seeds), seeds)
    return out


def repeated(scene: Scene, seeds: int, kinds: Sequence[Kind] = KINDS) -> dict[str, Found]:
    """Fits of every kind to so many noisy copies of the twin's motion, as users make them: by `fit_tendons`."""
    parameters = free_parameters(scene, SPRING_PARAMETERS)
    common = Evaluator(scene, parameters, (POSITION, SPRING))
    common.prepare(None)
    true = TRUE * parameters.nominal
    clean = common.with_slopes(true[None], _SHORT * common.first)
    data = [_noisy(scene, clean, seed) for seed in range(seeds)]
    out = {}
    for kind in kinds:
        asked: dict[str, Any] = {"objective": kind.objective, "use": kind.use, "computed": (POSITION, SPRING)}
        estimates = [fit_tendons(scene, m, **asked) for m in data]
        values = np.stack([e.values for e in estimates])
        deviations = np.stack([e.standard_deviations for e in estimates])
        known = bound(Objective.of(scene, data[0], kind.objective, use=kind.use), clean)
        out[kind.name] = Found(values, deviations, true, known)
    return out


def _noisy(scene: Scene, clean: Prediction, seed: int) -> Measured:
    """The twin's motion and one force with white noise."""
    random = np.random.default_rng(seed)
    path, pull = clean.values[0, :, :3], clean.values[0, :, 3]
    return Measured(
        np.asarray(scene.motion.times),
        path + random.normal(0.0, MARKER_NOISE, path.shape),
        femoral_spring_force=pull + random.normal(0.0, FORCE_NOISE, pull.shape),
        synthetic=True,
        source="the twin with marker noise",
    )


def bound(objective: Objective, clean: Prediction) -> Floats:
    """Cramer and Rao's (p, p), with white noise of the channels that are compared."""
    assert clean.slopes is not None
    width = objective.measured.shape[1]
    noise = np.array([MARKER_NOISE] * 3 + [FORCE_NOISE])[:width]
    flat = (clean.slopes[0, :, :width] / noise[:, None]).reshape(-1, clean.slopes.shape[-1])
    return inverse_information(flat.T @ flat)


def rows_of(motion: str, found: dict[str, Found], seeds: int) -> list[Row]:
    """Figures of one motion beside their targets."""
    likely, forced, paper = (found[kind.name] for kind in KINDS)
    out = []

    def add(what: str, value: float, unit: str, target: float | None = None, note: str = "") -> None:
        out.append(
            Row("efficiency", f"{motion}: {what}", float(value), unit, target, "at most", note, {"seeds": seeds})
        )

    for i, name in enumerate(SPRING_PARAMETERS):
        note = f"error {_percent(likely.errors[i])}, bound {_percent(likely.relative_bound[i])}, {seeds} seeds"
        add(f"{name}, rms error over its bound", likely.errors[i] / likely.relative_bound[i], "x", OVER_BOUND, note)
    for name, error in (("L1", likely.errors[1]), ("L2", likely.errors[3]), ("K1/K2", likely.ratio_error)):
        add(f"{name}, rms error", 100 * error, "%", PERCENT)
    for i, name in enumerate(SPRING_PARAMETERS):
        note = f"bound {_percent(forced.relative_bound[i])}"
        add(f"{name}, one spring force measured as well, rms error", 100 * forced.errors[i], "%", PERCENT, note)
    for what, one in (("positions", likely), ("with one force", forced)):
        each = ", ".join(f"{n} {100 * c:.0f} %" for n, c in zip(SPRING_PARAMETERS, one.coverage, strict=True))
        add(
            f"95 % intervals that contain the true value, least of four, {what}",
            100 * one.coverage.min(),
            "%",
            note=each,
        )
    for i, name in enumerate(SPRING_PARAMETERS):
        note = f"bound {_percent(paper.relative_bound[i])}"
        add(f"{name}, paper's objective, rms error", 100 * paper.errors[i], "%", note=note)
    return out


def _rms(a: Floats) -> Floats:
    return np.sqrt(np.mean(np.square(a), axis=0))


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
