"""The toe region of soft tissue: quadratic while its crimped fibres straighten, then linear; C1.

Source: Blankevoort & Huiskes 1991, J Biomech Eng 113:263 (their reference strain e1 is half the toe's end here).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.base.spatial import Scalar


class ToeRegion(NamedTuple):
    """Force, slope and energy for a linear region of slope 1."""

    force: Scalar
    slope: Scalar
    energy: Scalar


def toe_region(elongation: Scalar, toe: Scalar) -> ToeRegion:
    """With x the elongation where it is positive, else 0: f = x^2 / (2 toe) up to the toe's end, then x - toe / 2.

    Args:
        elongation: as a length or as a strain; negative where slack.
        toe: where the toe region ends, in the same unit; positive.
    """
    toes = elongation < toe
    x = jnp.maximum(elongation, 0.0)
    reference = 0.5 * toe
    force = jnp.where(toes, x * x / (2 * toe), x - reference)
    slope = jnp.where(toes, x / toe, 1.0)
    energy = jnp.where(toes, x**3 / (6 * toe), 0.5 * (x - reference) ** 2 + toe**2 / 24)
    return ToeRegion(force, slope, energy)
