"""Least values of quadratics within bounds: what a step of Levenberg and Marquardt is where parameters have bounds."""

from __future__ import annotations

import numpy as np

from pftwin.base.arrays import Floats

_ROUNDS = 4  # times the number of parameters: releases are few
_NOTHING = 1e-9  # pull on a stopped parameter that is none, of the largest at the start


def bounded_steps(matrix: Floats, gradient: Floats, lowest: Floats, highest: Floats) -> Floats:
    """The steps to the minima of quadratics within bounds, by a primal active-set method, many at once.

    Goes towards the minimum over what is free, stops at its bound what meets one first, goes on with the others, and
    lets go again what is pulled inwards once they have arrived: lower all the way. Source: Nocedal & Wright 2006,
    Numerical Optimization, section 16.5.

    Args:
        matrix: Hessians (..., p, p), positive definite.
        gradient: at the beginning (..., p).
        lowest: the steps to the bounds (..., p), at most 0, and `highest`, at least 0.
    """
    count, shape = matrix.shape[-1], matrix.shape[:-1]
    lowest, highest = np.minimum(lowest, 0.0), np.maximum(highest, 0.0)  # a bound may be passed by rounding
    size = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    step = np.zeros(shape)
    pull = np.broadcast_to(-gradient, shape)
    nothing = _NOTHING * (np.abs(pull) / size).max(axis=-1, keepdims=True)
    stopped = ((pull > 0) & (highest == 0)) | ((pull < 0) & (lowest == 0))
    for _ in range(_ROUNDS * (count + 1)):
        free = ~stopped
        among = np.where(free[..., :, None] & free[..., None, :], matrix, np.eye(count))
        ahead = np.linalg.solve(among, np.where(free, pull, 0.0)[..., None])[..., 0]
        room = np.where(ahead > 0, highest - step, step - lowest)
        share = np.where(np.abs(ahead) > room, room / np.maximum(np.abs(ahead), 1e-300), np.inf)
        least = share.min(axis=-1, keepdims=True)
        met = np.isfinite(share) & (share <= least)
        bound = np.where(ahead > 0, highest, lowest)
        step = np.where(met, bound, np.clip(step + np.minimum(least, 1.0) * ahead, lowest, highest))
        stopped = stopped | met
        pull = -gradient - np.einsum("...ij,...j->...i", matrix, step)
        inward = np.where(((pull < 0) & (step >= highest)) | ((pull > 0) & (step <= lowest)), np.abs(pull) / size, 0.0)
        most = np.where(stopped & np.isinf(least), inward, 0.0)
        release = (most > nothing) & (most >= most.max(axis=-1, keepdims=True))
        stopped = stopped & ~release
        if np.isinf(least).all() and not release.any():
            break
    return step
