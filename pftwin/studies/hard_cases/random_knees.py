"""Knees of numbers at random: coefficients, tendons and law drawn around the small knee's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pftwin.geometry.patch.polynomial import exponents
from pftwin.studies.hard_cases.ground import TiltedGround
from pftwin.studies.hard_cases.knee import PATELLAR_TENDON, QUADRICEPS, TROCHLEA, KneeNumbers, Law

DEGREE, BUMPS = 5, 4e-4  # of the bumps that are added to the trochlea, and their coefficients' size [m]


def bumpy(coefficients: np.ndarray) -> TiltedGround:
    """The trochlea with a polynomial of `DEGREE` added to its height, in coordinates from -1 to 1 [m]."""
    half, powers = TROCHLEA.half, exponents(DEGREE)

    def height(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        a, b = u / half[0], v / half[1]
        return TROCHLEA.height(u, v) + sum(c * a**i * b**j for c, (i, j) in zip(coefficients, powers, strict=True))

    return replace(TROCHLEA, height=height)


def drawn(seed: int) -> KneeNumbers:
    """A knee at random: every number is within what the rest of the catalogue has."""
    random = np.random.default_rng(seed)
    quadriceps, tendon = (
        replace(
            s, stiffness=s.stiffness * random.uniform(0.5, 2.0), slack_length=s.slack_length * random.uniform(0.9, 1.02)
        )
        for s in (QUADRICEPS, PATELLAR_TENDON)
    )
    law = Law(10 ** random.uniform(7.5, 9.5), random.uniform(1.3, 1.7), random.uniform(0.1, 1.0))
    ground = bumpy(random.normal(0, BUMPS, len(exponents(DEGREE))))
    mass = float(10 ** random.uniform(-1.5, -0.5))
    return KneeNumbers(ground=ground, law=law, mass=mass, quadriceps=quadriceps, patellar_tendon=tendon)
