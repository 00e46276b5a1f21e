"""Proposals for sampling a posterior of nonlinear least squares: randomise, then optimise.

A density exp(-|f|^2 / 2) of few parameters is often thin and bent: a stiffer tendon with more slack moves the patella
alike. So proposals are not drawn from a distribution about the estimate, but solved for: with Q the directions in which
residuals f at the estimate react to parameters, a proposal theta solves Q'f(theta) = eta, eta normal. Its density is

    |det Q' df/dtheta| exp(-|Q'f|^2 / 2),

for linear f the posterior itself, and else bent as it is: the method of Bardsley, Solonen, Haario and Laine (2014),
whose geometry arXiv:1903.00870 explains. First derivatives do, and all proposals are solved for side by side. An eta
whose solution lies outside the bounds, or is not found, is dropped: the same density, only on less than everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.posterior.density import BLOCK, Density, Seen
from pftwin.base.errors import InputError

Floats = NDArray[np.float64]

_TOLERANCE = 1e-2  # of Q'f - eta, in standard deviations: what is used is the density of the solution that was found
_ITERATIONS = 12  # of Newton's method
_MARGIN = 0.25  # of the range: how far beyond the bounds iterates may go
_SHORTER = 0.4  # of a step that led to nothing better
_FEWEST = 0.02  # share of solutions within the bounds, below which it is not worth while


class Proposals(NamedTuple):
    """N independent proposals."""

    theta: Floats  # (N, p)
    log_density: Floats  # (N,) of the posterior, up to a constant
    log_proposal: Floats  # (N,) of the proposals, up to a constant
    outside: int  # how many more were beyond the bounds
    unsolved: int  # how many more were not found
    evaluations: int


def proposals(
    density: Density, count: int, random: np.random.Generator, progress: Callable[[int], None] | None = None
) -> Proposals:
    """As many proposals as are wanted.

    Args:
        density: of the posterior.
        count: N.
        random: source of eta.
        progress: called with the number of proposals found so far.

    Raises:
        InputError: next to no solution lies within the bounds.
    """
    start = density(density.centre[None])
    found: list[Seen] = []
    have = tried = outside = evaluations = 0
    while have < count:
        eta = random.standard_normal((BLOCK, len(density.centre)))
        ended, good, spent = solved(density, start, eta)
        lower, upper = density.bounds
        inside = ((ended.theta >= lower) & (ended.theta <= upper)).all(axis=1)
        found.append(_rows(ended, np.flatnonzero(good & inside)))
        have, tried = have + len(found[-1].theta), tried + len(eta)
        outside, evaluations = outside + int(np.sum(good & ~inside)), evaluations + spent
        if have < _FEWEST * tried:
            raise InputError(
                f"{tried - have} of {tried} proposals lie beyond the bounds or cannot be simulated",
                where="estimate",
                expected="parameters that the measurements fix within the bounds",
                remedy="fewer parameters, priors, or wider bounds",
            )
        if progress is not None:
            progress(min(have, count))
    columns: Any = zip(*found, strict=True)
    seen = Seen(*(np.concatenate(a)[:count] for a in columns))
    volume = np.linalg.slogdet(seen.slope)[1]
    log_proposal = volume - 0.5 * np.sum(seen.along**2, axis=1)
    return Proposals(seen.theta, seen.log_density, log_proposal, outside, tried - have - outside, evaluations)


def solved(density: Density, start: Seen, eta: Floats) -> tuple[Seen, NDArray[np.bool_], int]:
    """Where Q'f = eta (N, p), from one start: the points reached, whether they are solutions, and evaluations.

    Newton's method for all at once. A step is shortened where the next one, with the old slope, would not be smaller:
    Deuflhard's natural monotonicity test. Residuals themselves may well
    grow on the way, since a thin bent density has steep sides.
    """
    lower, upper = density.bounds
    span = upper - lower
    now = _rows(start, np.zeros(len(eta), dtype=np.intp))
    size = np.ones(len(eta))
    evaluations = 1
    for _ in range(_ITERATIONS):
        off = now.along - eta
        open_ = np.flatnonzero(np.linalg.norm(off, axis=1) > _TOLERANCE)
        if not open_.size:
            break
        inverse = _inverses(now.slope[open_])
        step = _product(inverse, off[open_])
        trial = now.theta[open_] - size[open_, None] * step
        new = density(np.clip(trial, lower - _MARGIN * span, upper + _MARGIN * span))
        evaluations += len(trial)
        after = np.linalg.norm(_product(inverse, new.along - eta[open_]) / span, axis=1)
        smaller = after < (1 - size[open_] / 4) * np.linalg.norm(step / span, axis=1)
        smaller = (smaller | (np.linalg.norm(new.along - eta[open_], axis=1) <= _TOLERANCE)) & new.usable
        columns: Any = zip(now, new, strict=True)
        for kept, fresh in columns:
            kept[open_[smaller]] = fresh[smaller]
        size[open_] = np.where(smaller, np.minimum(1.0, 2 * size[open_]), _SHORTER * size[open_])
    good = now.usable & (np.linalg.norm(now.along - eta, axis=1) <= _TOLERANCE)
    return now, good, evaluations


def _product(matrices: Floats, vectors: Floats) -> Floats:
    return (matrices @ vectors[..., None])[..., 0]


def _inverses(slope: Floats) -> Floats:
    """Pseudo-inverses (N, p, p), since a slope may be singular; parameters scaled alike before."""
    scale = np.linalg.norm(slope, axis=1)
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.pinv(slope / scale[:, None, :]) / scale[:, :, None]


def _rows(seen: Seen, rows: NDArray[np.intp]) -> Seen:
    columns: Any = seen
    return Seen(*(a[rows] for a in columns))
