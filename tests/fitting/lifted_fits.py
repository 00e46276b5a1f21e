"""Fits of the springs of the knee whose patella lifts off and falls back; what they share is made once a process."""

from __future__ import annotations

from functools import cache

import numpy as np
from lifting_scene import lifting_scene

import fitting
import pftwin
from fitting.estimate import Estimate
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene

SPRINGS = ("K1", "L1", "K2", "L2")
TRUTH = np.array([156.0, 0.1432, 629.0, 0.0714]) * np.array([1.1, 0.97, 0.92, 1.02])
NOISE = 1e-4  # [m]
FEW = {"starts": 8}


@cache
def scene() -> Scene:
    return lifting_scene()


@cache
def truth() -> pftwin.Result:
    """The motion with the true springs, at the steps that fits end with."""
    return pftwin.simulate(
        fitting.free_parameters(scene(), SPRINGS).apply(scene(), TRUTH), dt=1 / 2400, integrator=pftwin.LinearImplicit()
    )


@cache
def clean() -> Measured:
    return Measured(truth().times, truth().center, synthetic=True, source="twin")


def noisy(seed: int) -> Measured:
    return Measured(truth().times, truth().center + np.random.default_rng(seed).normal(0.0, NOISE, (41, 3)))


@cache
def estimate() -> Estimate:
    return fitting.fit_tendons(scene(), noisy(0), noise={"position": NOISE}, **FEW)
