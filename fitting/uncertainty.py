"""Covariance of a fit from the Gauss-Newton Hessian and the noise, and the precision in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.objective import Objective
from fitting.parameters import Parameters
from fitting.programs import POSITION, unit_of
from pftwin.base.arrays import Floats
from pftwin.base.quantities import as_read, shown

NORMAL_95 = 1.959963984540054  # quantile of the normal distribution for 95 % intervals
SERIAL = 0.2  # correlation of neighbouring residuals above which they do not count as independent
POORLY = 0.02  # relative standard deviation worth a remark
_OPEN = 0.87  # ratio of posterior to prior standard deviation above which measurements add hardly anything
_USELESS = 10  # relative standard deviation above which a value has no useful accuracy
_MINOR = 0.1  # share of a parameter's square within open combinations, below which it is not named
_SINGULAR = 1e-12  # eigenvalue of the information on parameters in units of their deviations that counts as zero
_HUGE = 1e6  # replaces infinite standard deviations, in units of the prior's


class Uncertainty(NamedTuple):
    """The uncertainty of a fit."""

    covariance: Floats  # (p, p)
    condition: float  # condition number of the information on relative parameters, as if noise were independent
    serial: float  # correlation of neighbouring residuals, over all channels


def uncertainty(objective: Objective, parameters: Parameters, r: Floats, j: Floats, theta: Floats) -> Uncertainty:
    """Uncertainty from residuals (n, m) and their derivatives (n, m, p) at theta, for an objective of known noise.

    If neighbouring residuals are correlated, the covariance is that of Newey and West (1987), which accounts for it;
    otherwise it is the inverse of the information.
    """
    z, a = scaled_by_noise(objective, r, j)
    precision = np.diag(parameters.prior_terms(theta)[2])
    information = objective.share * np.einsum("tmp,tmq->pq", a, a) + precision
    serial = serial_correlation(z, objective.present)
    middle = None
    if serial > SERIAL:
        middle = objective.share**2 * long_run_score(a, z, serial, objective.frames) + precision
    covariance = inverse_information(information, middle)
    scale = np.abs(sizes(parameters.names, parameters.upper - parameters.lower, theta, parameters.coordinates))
    values = np.linalg.eigvalsh(information * np.outer(scale, scale))
    condition = float(values[-1] / values[0]) if values[0] > 0 else np.inf
    return Uncertainty(0.5 * (covariance + covariance.T), condition, serial)


def scaled_by_noise(objective: Objective, r: Floats, j: Floats) -> tuple[Floats, Floats]:
    """Residuals (n, m) and derivatives (n, m, p) in units of the noise, zero where nothing was measured."""
    sigma = objective.noise_columns
    present = objective.present
    return np.where(present, r / sigma, 0.0), np.where(present[..., None], j / sigma[:, None], 0.0)


def inverse_information(information: Floats, score: Floats | None = None) -> Floats:
    """The inverse of an information matrix, with huge variances where it is singular; or, with the covariance of the
    score, the "sandwich" of that between two inverses."""
    d = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(d, d))
    values = np.maximum(values, 1e-15)
    middle = np.diag(values)
    if score is not None:
        # In singular directions the score is rounding, whose sign would decide that of a variance.
        known = values > _SINGULAR
        middle = np.where(known[:, None] & known, vectors.T @ (score / np.outer(d, d)) @ vectors, middle)
    with np.errstate(over="ignore"):  # infinite where nothing depends on a parameter
        return (vectors / values) @ middle @ (vectors / values).T / np.outer(d, d)


def serial_correlation(z: Floats, present: NDArray[np.bool_]) -> float:
    """Correlation of neighbouring residuals (n, m), over all columns."""
    both = present[1:] & present[:-1]
    squares = np.sum(z[present] ** 2)
    return float(np.sum((z[1:] * z[:-1])[both]) / squares) if squares > 0 and both.any() else 0.0


def long_run_score(a: Floats, z: Floats, serial: float, frames: tuple[slice, ...] = (slice(None),)) -> Floats:
    """Long-run covariance of the score's sum (p, p), with Bartlett weights over some correlation lengths.

    `frames`: rows of each trial; different trials are uncorrelated.
    """
    score = np.einsum("tmp,tm->tp", a, z)
    parts = [score[rows] for rows in frames]
    mean = np.concatenate(parts).mean(axis=0)
    parts = [part - mean for part in parts]
    length = 1 / max(1e-3, -np.log(min(max(serial, 0.05), 0.995)))
    lags = int(np.clip(np.ceil(4 * length), 1, max(map(len, parts)) // 6))
    total = np.sum([part.T @ part for part in parts], axis=0)
    for lag in range(1, lags + 1):
        across = np.sum([part[lag:].T @ part[:-lag] for part in parts if len(part) > lag], axis=0)
        total += (1 - lag / (lags + 1)) * (across + across.T)
    return total


def sizes(names: tuple[str, ...], span: Floats, values: Floats, coordinates: tuple[str, ...] = ()) -> Floats:
    """What relative deviations are relative to (p,): the values, or the range between bounds for coordinates of points,
    which may lie near zero, and for values of zero."""
    return np.where((values == 0) | np.isin(names, coordinates), span, values)


def relative(size: Floats, covariance: Floats) -> Floats:
    """Covariance of relative deviations."""
    return covariance / np.outer(size, size)


class Undetermined(NamedTuple):
    """Combinations of parameters that are hardly known beyond the prior."""

    count: int
    names: tuple[str, ...]  # parameters in them, the most involved first

    @staticmethod
    def of(names: tuple[str, ...], known: Floats, covariance: Floats) -> Undetermined:
        """From prior standard deviations (p,) and the posterior covariance (p, p)."""
        limited = np.where(np.isfinite(covariance), covariance, np.eye(len(names)) * (_HUGE * known) ** 2)
        values, vectors = np.linalg.eigh(relative(known, limited))
        inside = np.sum(vectors[:, values > _OPEN**2] ** 2, axis=1)
        order = np.argsort(-inside, kind="stable")
        count = int(np.sum(values > _OPEN**2))
        return Undetermined(count, tuple(names[i] for i in order if inside[i] > _MINOR))


def in_words(
    names: tuple[str, ...],
    span: Floats,
    values: Floats,
    covariance: Floats,
    channels: tuple[str, ...],
    coordinates: tuple[str, ...] = (),
    readings: Mapping[str, str] | None = None,
    units: Sequence[str] | None = None,
    set_by_bounds: Collection[str] = (),
) -> str:
    """A sentence on which parameters the data determine and how well, with values if `units` are given. `readings`:
    units of channels that are neither poses nor forces; `set_by_bounds`: parameters of which no deviation is stated."""
    rel = relative(sizes(names, span, values, coordinates), covariance)
    sd = np.sqrt(np.maximum(np.diagonal(rel), 0))
    subject = "positions" if channels == (POSITION,) else ", ".join(channels)
    verb = "fix" if units is None else "give"
    verb += "" if channels == (POSITION,) or len(channels) > 1 else "es" if verb == "fix" else "s"
    bases = [n.partition("[")[0] for n in names]
    stiff = [i for i, n in enumerate(bases) if n.endswith(".stiffness") or (n[:1] == "K" and n[1:].isdigit())]
    parts, rest, weak = [], list(range(len(sd))), ""
    if len(stiff) == 2:
        a, b = stiff
        ratio = np.sqrt(max(rel[a, a] + rel[b, b] - 2 * rel[a, b], 0))
        common = 0.5 * np.sqrt(max(rel[a, a] + rel[b, b] + 2 * rel[a, b], 0))
        if common > 3 * ratio:
            parts.append(f"{names[a]}/{names[b]} to {percent(ratio)}")
            rest = [i for i in rest if i not in stiff]
            weak = f", the common scale of {names[a]} and {names[b]} only to {percent(common)}"
            forces = [c for c in channels if unit_of(c, readings or {}) == "N"]
            if common > POORLY and not forces:
                weak += ": measure one force to fix both"
    width = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    if units is None:
        parts += [f"{names[i]} to {_length(width[i]) if names[i] in coordinates else percent(sd[i])}" for i in rest]
    else:
        for i in rest:
            words = _with_deviation(values[i], width[i], sd[i], units[i])
            if names[i] in set_by_bounds:
                words = f"= {shown(values[i], units[i], 4)} (at its bound)"
            parts.append(f"{names[i]} {words}")
    text = f"{subject} {verb} {_listed(parts)}{' (SD)' if any(' +- ' in part for part in parts) else ''}{weak}"
    if not weak and len(sd) > 1:
        values_, vectors = np.linalg.eigh(rel)
        if np.sqrt(values_[-1]) > POORLY and np.sqrt(values_[-1]) > 1.3 * sd.max():
            worst = [names[i] for i in np.argsort(-np.abs(vectors[:, -1]))[:2]]
            text += f"; the weakest combination is of {worst[0]} and {worst[1]}"
    return text


def percent(share: float) -> str:
    """A share as a percentage, or words if it is useless."""
    if not np.isfinite(share) or share > _USELESS:
        return "no useful accuracy"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def _with_deviation(value: float, deviation: float, share: float, unit: str) -> str:
    """A value and its standard deviation to two digits, or to whole units; words if the relative `share` is useless."""
    scale, read = as_read(unit)
    if not np.isfinite(deviation) or share > _USELESS:
        return "with no useful accuracy"
    digits = max(0, 1 - int(np.floor(np.log10(scale * deviation)))) if deviation > 0 else 6
    return f"= {scale * value:.{digits}f} +- {scale * deviation:.{digits}f} {read}".removesuffix(" 1")


def _length(deviation: float) -> str:
    """Standard deviation of a coordinate [m], as text."""
    return f"{1e3 * deviation:.2g} mm" if np.isfinite(deviation) and deviation < 1 else "no useful accuracy"


def _listed(parts: list[str]) -> str:
    return f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else "".join(parts) or "nothing"
