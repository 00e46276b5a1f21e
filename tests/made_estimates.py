"""Estimates as fits leave them, without a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fitting.estimate import Estimate, FittedTrial
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

UNITS = {"K": "N/m", "L": "m"}  # by a spring parameter's letter


def made_estimate(values: Mapping[str, tuple[float, float]], **more: Any) -> Estimate:
    """Of spring parameters by name, each with its standard deviation; `more` in the place of other fields.

    Nominal values, bounds and the estimates' places between them are all unlike, so that none passes for another.
    """
    numbers, deviations = np.array(list(values.values())).T
    nominal = numbers / (1 + 0.04 * (1 + np.arange(len(numbers))))  # 4, 8, 12 ... % were found to be missing
    fields: dict[str, Any] = {
        "names": tuple(values),
        "units": tuple(UNITS.get(name[0], "") for name in values),
        "values": numbers,
        "covariance": np.diag(deviations**2),
        "lower": 0.7 * nominal,
        "upper": 1.3 * nominal,
        "nominal": nominal,
        "objective": "paper",
        "objective_value": 0.0,
        "objective_unit": "m",
        "channels": ("position",),
        "noise": {},
        "noise_known": False,
        "serial_correlation": 0.0,
        "condition": 1.0,
        "rmse": {},
        "method": "least_squares",
        "seed": 0,
        "reason": "converged",
        "evaluations": 1,
        "iterations": 1,
        "starts": 1,
        "dropped": 0,
        "seconds": 1.0,
        "history": [],
        "synthetic": True,
        "source": "the virtual rig",
        "scene_name": "rig case 2, P5",
    }
    return Estimate(**{**fields, **more})


def of_trial(scene: Scene, measured: Measured | None = None) -> dict[str, Any]:
    """What an estimate of one trial holds of it, for `made_estimate`."""
    return {"trials": (FittedTrial(scene, measured),)}
