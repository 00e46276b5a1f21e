"""Problems of two parameters for tests of sampling: residuals given by a formula, in units of their noise."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from fitting.evaluation import Prediction
from fitting.methods.problem import Problem
from fitting.objective import Objective
from fitting.parameters import Parameter, Parameters


def problem(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    lower=(-50.0, -50.0),
    upper=(50.0, 50.0),
    prior: tuple[float, float] | None = None,
    usable: Callable[[np.ndarray], np.ndarray] = lambda theta: np.ones(len(theta), bool),
) -> Problem:
    """From points (N, 2) to residuals (N, n, 3) and derivatives (N, n, 3, 2)."""

    def with_slopes(theta, substeps):
        values, slopes = function(theta)
        return Prediction(values, slopes, usable(theta))

    place: Any = None
    items = [
        Parameter(name, place, 0.5 * (lo + up), lo, up, known)
        for name, lo, up, known in zip("ab", lower, upper, (prior, None), strict=True)
    ]
    shape = function(np.zeros((1, 2)))[0].shape[1:]
    target = Objective(
        "likelihood",
        ("position",),
        np.zeros(shape),
        np.ones(shape, bool),
        ("position",),
        np.zeros(3, int),
        {"position": 1.0},
        "linear",
        True,
        "a formula",
    )
    evaluator: Any = SimpleNamespace(with_slopes=with_slopes, fine=1)
    scene: Any = None
    return Problem(scene, Parameters(tuple(items)), target, evaluator)


def linear(design: np.ndarray, measured: np.ndarray) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Of a design (n, 3, 2) and measurements (n, 3)."""

    def function(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.einsum("tmp,np->ntm", design, theta) - measured
        return values, np.broadcast_to(design, (len(theta), *design.shape))

    return function


def bent(width: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """a is normal; b, given a, is normal about a squared with a standard deviation of `width`."""

    def function(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = theta.T
        nothing = np.zeros_like(a)
        values = np.stack([a, (b - a**2) / width, nothing], axis=-1)[:, None]
        by_a = np.stack([nothing + 1, -2 * a / width, nothing], axis=-1)
        by_b = np.stack([nothing, nothing + 1 / width, nothing], axis=-1)
        return values, np.stack([by_a, by_b], axis=-1)[:, None]

    return function


def cubic(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """a, a cubed over four and b: a density whose moments are not those of its proposals."""
    a, b = theta.T
    values = np.stack([a - 1, a**3 / 4, b], axis=-1)[:, None]
    nothing = np.zeros_like(a)
    by_a = np.stack([nothing + 1, 0.75 * a**2, nothing], axis=-1)
    by_b = np.stack([nothing, nothing, nothing + 1], axis=-1)
    return values, np.stack([by_a, by_b], axis=-1)[:, None]
