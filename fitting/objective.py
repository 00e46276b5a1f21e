"""The distance between predictions and measurements: the paper's sum of errors, or a likelihood.

With S the mean square of a group of residuals over its n measured values, the objective is a sum over groups of

| objective | groups | term |
|---|---|---|
| paper (Michaud et al. 2024, section 2.6) | X, Y, Z of the sphere's centre in the femur frame | sqrt(S) [m] |
| likelihood, noise known | every channel: position, orientation, each force | n S / (2 noise^2) |
| likelihood, noise unknown | the same | (n / 2) log S: the noise at its most likely value |

Every term is a concave function of S, so weighted least squares with weights from its slope (iteratively reweighted, as
for robust losses) reduces the objective at least as much as its quadratic model predicts.

Missing measurements (NaN) are omitted. All of this runs on the host, in numpy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.evaluation import Prediction
from fitting.measured_channels import check_times, chosen_channels
from fitting.metric import Metric, StatedNoise, check_noise, covariances, level
from fitting.programs import ORIENTATION, POSITION, reading_units, side_by_side
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

OBJECTIVES = ("likelihood", "paper")
LOSSES = ("linear", "huber", "soft_l1")
SPRINGS = {"femoral": "quadriceps", "tibial": "patellar_tendon"}  # effect of each measured spring force
_AXES = ("X", "Y", "Z")
_SMALLEST = {POSITION: 1e-7, ORIENTATION: 1e-6}  # residuals below these are rounding [m], [rad]
_SMALLEST_FORCE = 1e-5  # the same for a force [N]
_SMALLEST_SHARE = 1e-6  # the same for another reading, as a share of its root mean square
_HUBER = 1.345  # residual from which the loss is linear, in units of the noise


class Normal(NamedTuple):
    """Objective and quadratic model of N variants; infinite value and zero derivatives where one is not usable."""

    value: Floats  # (N,)
    gradient: Floats  # (N, p)
    hessian: Floats  # (N, p, p), Gauss-Newton


@dataclass(frozen=True, eq=False)
class Objective:
    """Measurements of a scene's motion and how predictions are compared with them; made by `Objective.of`."""

    kind: str
    channels: tuple[str, ...]  # in the evaluator's order
    measured: Floats  # (n, c) in the columns of the predictions
    present: NDArray[np.bool_]  # (n, m) which residuals exist
    groups: tuple[str, ...]
    group_of: NDArray[np.intp]  # (m,) the group of each residual column
    noise: dict[str, float] | None  # by group; None: unknown
    loss: str
    synthetic: bool
    source: str
    share: float = 1.0  # share of the likelihood that counts beside priors: see `fitting.finish`
    frames: tuple[slice, ...] = (slice(None),)  # rows of each trial: see `fitting.trials`
    sources: tuple[str, ...] = ()  # sources of the measurements of several trials
    metric: Metric | None = None  # weights of frames and columns; None: all equal
    covariances: dict[str, list[list[float]]] = field(default_factory=dict)  # of noise stated as a covariance
    readings: dict[str, str] = field(default_factory=dict)  # units of channels that are neither poses nor forces

    @staticmethod
    def of(
        scene: Scene,
        measured: Measured,
        kind: str = "likelihood",
        *,
        use: str | Sequence[str] = POSITION,
        noise: StatedNoise | None = None,
        loss: str = "linear",
        springs: Mapping[str, str] = SPRINGS,
    ) -> Objective:
        """Makes the objective that compares a scene with measurements.

        Args:
            scene: the nominal scene.
            measured: measurements at the frames of its motion.
            kind: "likelihood" or "paper".
            use: channels: "position", "orientation", an effect's name for its force ("contact", "quadriceps"), or any
                other observable of an effect ("contact.force_medial"); "all": all that were measured. By default
                positions, the only channel of the paper's objective.
            noise: standard deviation of each channel's measurements [m], [rad], [N], or the covariance (3, 3) of a
                position or of a rotation about the femur's axes; by default estimated from the residuals.
            loss: "linear", or for outliers "huber" or "soft_l1", which need the noise.
            springs: names of the effects whose tensions were measured as "femoral" and "tibial" spring forces.

        Raises:
            InputError: times that differ from the scene's (number, rate or start); no measured channel for this
                objective; an unknown objective, channel or loss; a noise that is missing or not positive.
        """
        _check_kind(kind, loss, noise)
        check_times(scene, measured)
        data = chosen_channels(scene, measured, kind, use, springs)
        channels = tuple(data)
        if noise is not None:
            check_noise(noise, channels, _residuals_of(channels))
        there = np.stack([np.isfinite(values).all(axis=1) for values in data.values()], axis=1)
        weights = measured.weights
        if weights is not None:
            there &= weights[:, None] > 0
            if uncounted := [c for i, c in enumerate(channels) if not there[:, i].any()]:
                found = f"no frame in which {uncounted[0]} was measured counts"
                raise InputError(found, where=measured.source, expected="a weight that is not 0")
            weights = weights / weights[weights > 0].mean()
        own = None if noise is None else {c: noise[c] for c in channels}
        column_channel, stated = channel_of_columns(channels), covariances(own)
        return Objective(
            kind,
            channels,
            np.concatenate(list(data.values()), axis=1),
            there[:, column_channel],
            _AXES if kind == "paper" else channels,
            np.arange(3) if kind == "paper" else column_channel,
            None if own is None else {c: level(value) for c, value in own.items()},
            loss,
            measured.synthetic,
            measured.source,
            metric=Metric.of(weights, len(there), stated),
            covariances=stated,
            readings=reading_units(scene, channels),
        )

    @property
    def trials(self) -> tuple[Objective, ...]:
        """The measurements of each trial."""
        return tuple(
            replace(
                self,
                measured=self.measured[rows],
                present=self.present[rows],
                source=source,
                metric=None if self.metric is None else self.metric.at(rows),
                frames=(slice(None),),
                sources=(),
            )
            for rows, source in zip(self.frames, self.sources or (self.source,), strict=True)
        )

    @property
    def unweighted(self) -> Objective:
        """With all columns weighted equally, to state residuals; frames keep their weights."""
        return self if self.metric is None else replace(self, metric=self.metric._replace(channels={}))

    @property
    def stated_noise(self) -> StatedNoise | None:
        """The noise as stated: standard deviations and covariances by channel."""
        return None if self.noise is None else {**self.noise, **self.covariances}

    @property
    def unit(self) -> str:
        """Unit of the objective's value."""
        return "m" if self.kind == "paper" else "nats"

    def tolerance(self, value: Floats | float) -> Floats:
        """Smallest decrease worth another iteration, from these values."""
        return 1e-7 * np.abs(value) if self.kind == "paper" else np.full(np.shape(value), 1e-3)

    def residuals(self, values: Floats) -> Floats:
        """Predicted minus measured (N, n, m), 0 if not measured; rotations as 2 sin(angle / 2) times the axis."""
        return self._compared(values[..., None], offset=True)[..., 0]

    def slopes(self, slopes: Floats, values: Floats) -> Floats:
        """Derivatives (N, n, m, p) of the residuals from those of the predictions (N, n, c, p)."""
        return self._compared(slopes, offset=False, values=values)

    def linear(self, prediction: Prediction) -> tuple[Floats, Floats]:
        """Residuals (N, n, m) and their derivatives (N, n, m, p); those of zeros if a prediction is not usable."""
        assert prediction.slopes is not None
        values = np.where(prediction.usable[:, None, None], prediction.values, 0.0)
        slopes = np.where(prediction.usable[:, None, None, None], prediction.slopes, 0.0)
        return self.residuals(values), self.slopes(slopes, values)

    def mean_squares(self, residuals: Floats) -> Floats:
        """Mean square of each group over its measured values (N, groups)."""
        return self._by_group(np.sum(residuals**2, axis=1)) / self._counts

    def value(self, prediction: Prediction) -> Floats:
        """The objective (N,); infinite if a prediction is not usable."""
        with np.errstate(all="ignore"):
            value = self._value(self.residuals(prediction.values))
        return np.where(prediction.usable & np.isfinite(value), value, np.inf)

    def normal(self, prediction: Prediction) -> Normal:
        """The objective with its gradient and Gauss-Newton Hessian with respect to the parameters."""
        usable, (r, j) = prediction.usable, self.linear(prediction)
        weights, n, p = self._weights(r), len(r), j.shape[-1]
        flat, weighted = j.reshape(n, -1, p), (weights[..., None] * j).reshape(n, -1, p)
        gradient = np.einsum("ikp,ik->ip", weighted, r.reshape(n, -1))
        hessian = np.swapaxes(weighted, 1, 2) @ flat
        value = np.where(usable, self._value(r), np.inf)
        return Normal(value, np.where(usable[:, None], gradient, 0), np.where(usable[:, None, None], hessian, 0))

    def pull(self, values: Floats) -> Floats:
        """Derivatives of the objective with respect to the predictions (N, n, c), for reverse mode."""
        r = self.residuals(values)
        weighted = self._weights(r) * r
        if self.metric is not None:
            weighted = self.metric.times(weighted[..., None], self._rows, transposed=True)[..., 0]
        out = np.zeros(values.shape)
        for channel, columns, rows in self.columns():
            part = weighted[..., rows]
            if channel == ORIENTATION:
                part = np.einsum("ijkl,ijk->ijl", self._turn(values[..., columns], columns), part)
            out[..., columns] = part
        return out

    def noise_of(self, residuals: Floats, parameters: int) -> dict[str, float]:
        """Noise of each channel estimated from residuals (n, m), corrected for the number of free parameters."""
        own = self.known(dict.fromkeys(self.channels, 1.0))
        counts, total = own._counts, self.present.sum()
        squares = own._by_group(np.sum(residuals**2, axis=0))
        return {
            c: float(np.sqrt(s / max(k - parameters * k / total, 1.0)))
            for c, s, k in zip(self.channels, squares, counts, strict=True)
        }

    def known(self, noise: Mapping[str, float]) -> Objective:
        """The same measurements as a likelihood with known noise, for covariances."""
        by_channel = {"groups": self.channels, "group_of": channel_of_columns(self.channels), "noise": dict(noise)}
        return replace(self, kind="likelihood", loss="linear", **by_channel)

    @property
    def _counts(self) -> Floats:
        return self._by_group(self.present.sum(axis=0).astype(float))

    def _by_group(self, columns: Floats) -> Floats:
        """Sums over the columns (..., m) of each group (..., groups)."""
        return np.stack([columns[..., self.group_of == g].sum(axis=-1) for g in range(len(self.groups))], axis=-1)

    @property
    def floor(self) -> Floats:
        """Mean square of each group below which residuals are rounding (groups,)."""
        sizes = {
            c: _SMALLEST_SHARE * float(np.sqrt(np.mean(self.measured[self.present[:, rows.start], columns] ** 2)))
            for c, columns, rows in self.columns()
            if c in self.readings
        }
        known = _SMALLEST | {c: max(size, 1e-150) for c, size in sizes.items()}
        return np.array([known.get(POSITION if g in _AXES else g, _SMALLEST_FORCE) ** 2 for g in self.groups])

    def _value(self, r: Floats) -> Floats:
        s = self.mean_squares(r)
        if self.noise is None:
            s = s + self.floor
            if self.kind == "paper":
                return np.sqrt(s).sum(axis=-1)
            return 0.5 * self.share * (self._counts * np.log(s)).sum(axis=-1)
        return 0.5 * self.share * _rho(np.square(r / self.noise_columns), self.loss).sum(axis=(1, 2))

    def _weights(self, r: Floats) -> Floats:
        """Twice the derivative of the objective with respect to each squared residual (N, n, m) or (N, 1, m)."""
        if self.noise is not None:
            return self.share * _rho_slope(np.square(r / self.noise_columns), self.loss) / self.noise_columns**2
        s = self.mean_squares(r) + self.floor
        slope = 1 / (self._counts * np.sqrt(s)) if self.kind == "paper" else self.share / s
        return slope[:, None, self.group_of]

    @property
    def noise_columns(self) -> Floats:
        """Noise of each residual column (m,); only if it is known."""
        assert self.noise is not None
        return np.array([self.noise[g] for g in self.groups])[self.group_of]

    def _turn(self, q: Floats, columns: slice) -> Floats:
        """Matrices (N, n, 3, 4) from predicted quaternions to rotations relative to the measured ones."""
        measured = self.measured[:, columns]
        w, x, y, z = measured.T
        rows = np.stack([np.stack(a, -1) for a in ((-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w))], axis=1)
        sign = np.where(np.einsum("ijk,jk->ij", q, measured) < 0, -2.0, 2.0)
        return np.nan_to_num(sign[..., None, None] * rows)

    def _compared(self, a: Floats, *, offset: bool, values: Floats | None = None) -> Floats:
        """Converts columns of predictions or of their derivatives (N, n, c, k) to those of residuals (N, n, m, k)."""
        quaternions, out = a[..., 0] if values is None else values, []
        for channel, columns, _ in self.columns():
            part = a[..., columns, :]
            if channel == ORIENTATION:
                part = self._turn(quaternions[..., columns], columns) @ part
            elif offset:
                part = part - self.measured[:, columns, None]
            out.append(part)
        found = np.where(self.present[:, :, None], np.concatenate(out, axis=2), 0.0)
        return found if self.metric is None else self.metric.times(found, self._rows)

    @property
    def _rows(self) -> list[tuple[str, slice]]:
        return [(channel, rows) for channel, _, rows in self.columns()]

    def columns(self) -> Iterator[tuple[str, slice, slice]]:
        """Each channel with its columns in the predictions and in the residuals."""
        ends = np.cumsum(counts := _residuals_of(self.channels)).tolist()
        for (channel, columns), count, end in zip(side_by_side(self.channels), counts, ends, strict=True):
            yield channel, columns, slice(end - count, end)


def _check_kind(kind: str, loss: str, noise: StatedNoise | None) -> None:
    """Raises InputError for an unknown objective or loss, or for one that does not go with the noise."""
    if kind not in OBJECTIVES:
        raise InputError(f"no objective {kind!r}", where="objective", expected=f"one of: {', '.join(OBJECTIVES)}")
    if loss not in LOSSES:
        raise InputError(f"no loss {loss!r}", where="loss", expected=f"one of: {', '.join(LOSSES)}")
    if noise is not None and kind == "paper":
        found, expected = "given with the paper's objective, which knows none", "the likelihood, or no noise"
        raise InputError(found, where="noise", expected=expected)
    if noise is None and loss != "linear":
        found = f"the loss {loss!r} needs the measurements' noise to detect outliers"
        raise InputError(found, where="loss", expected='a likelihood with noise, such as noise={"position": 2e-4}')


def channel_of_columns(channels: tuple[str, ...]) -> NDArray[np.intp]:
    """The channel of each residual column (m,)."""
    return np.repeat(np.arange(len(channels)), _residuals_of(channels))


def _residuals_of(channels: Sequence[str]) -> list[int]:
    """Number of residuals per frame of each channel."""
    return [3 if c in (POSITION, ORIENTATION) else 1 for c in channels]


def _rho(z: Floats, loss: str) -> Floats:
    """Loss of squared residuals in units of the noise."""
    if loss == "huber":
        return np.where(z <= _HUBER**2, z, 2 * _HUBER * np.sqrt(np.maximum(z, _HUBER**2)) - _HUBER**2)
    return 2 * (np.sqrt(1 + z) - 1) if loss == "soft_l1" else z


def _rho_slope(z: Floats, loss: str) -> Floats:
    if loss == "huber":
        return np.where(z <= _HUBER**2, 1.0, _HUBER / np.sqrt(np.maximum(z, _HUBER**2)))
    return 1 / np.sqrt(1 + z) if loss == "soft_l1" else np.ones_like(z)
