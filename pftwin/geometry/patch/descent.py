"""A step downhill in two coordinates: Newton's, where that is safe, with a derivative written by hand.

The step solves H d = -g. So does its derivative, H dd = -dg - dH d: two equations with the same pivots for each column.
That is fewer operations than the derivatives of divisions, choices and limits one by one.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from pftwin.base.spatial import Scalar

PUSH = 0.04  # of the longest step: what moves a point off a saddle
FLATTEST = 0.1  # curvatures of the distance below this share of the tangents' own are raised to it


class Slope(NamedTuple):
    """What goes downhill, and how far it may."""

    gradient: tuple[Scalar, Scalar]
    hessian: tuple[Scalar, Scalar, Scalar]  # uu, uv, vv
    gram: tuple[Scalar, Scalar]  # squares of the tangents along u and v
    longest: tuple[Scalar, Scalar]  # the longest step along u and v


class DescentStep(NamedTuple):
    """A step, and how its equations were solved."""

    du: Scalar
    dv: Scalar
    over_u: Scalar  # inverse pivots
    over_v: Scalar
    ratio: Scalar  # of the first equation that the second takes
    convex: Scalar  # 1 where the Hessian is positive definite, else 0; a number, as a choice has no derivative


def _limited(x: Scalar, most: Scalar) -> Scalar:
    """x held within +-most."""
    return jnp.where(x > most, most, jnp.where(x < -most, -most, x))


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def descend(slope: Slope, side: float) -> DescentStep:
    """The step from where a slope was looked at.

    Where the Hessian is positive definite it is Newton's, with pivots raised to `FLATTEST`; elsewhere curvatures are
    taken by their size, each coordinate for itself, with a small push along v to that side. Derivatives pass to the
    step alone: pivots are what they are.

    Args:
        slope: gradient, Hessian, and how far the step may go.
        side: +1 or -1.
    """
    (gu, gv), (huu, huv, hvv), gram, (along, across) = slope
    convex = (huu > 0) & (huu * hvv > huv * huv)
    # Raising the second pivot alone keeps a flat valley's direction.
    over_u = 1 / jnp.maximum(jnp.where(convex, huu, jnp.abs(huu)), FLATTEST * gram[0])
    ratio = jnp.where(convex, huv, 0.0) * over_u
    over_v = 1 / jnp.maximum(jnp.where(convex, hvv - ratio * huv, jnp.abs(hvv)), FLATTEST * gram[1])
    dv = _limited((ratio * gu - gv) * over_v + jnp.where(convex, 0.0, side * PUSH * across), across)
    du = _limited(-gu * over_u - ratio * dv, along)
    return DescentStep(du, dv, over_u, over_v, ratio, jnp.where(convex, 1.0, 0.0))


@descend.defjvp
def _descend_jvp(side: float, primals: tuple[Any], tangents: tuple[Any]) -> tuple[DescentStep, DescentStep]:
    ((slope,), (change,)) = primals, tangents
    ((gu, _), (huu, huv, hvv), gram, (along, across)), (dg, dh, _, dl) = slope, change
    step = descend(slope, side)
    du, dv, over_u, over_v, ratio, convex = step
    free = -gu * over_u - ratio * dv  # du without its limit, which is what the equations have
    push = (1 - convex) * (side * PUSH)
    # What of the Hessian the two equations have: raised pivots hang on none of it, turned ones on it the other way.
    # The second pivot is hvv - ratio huv; where it is raised, its equation still has ratio huv = huv^2 / huu.
    raised_u = jnp.abs(huu) <= FLATTEST * gram[0]
    raised_v = jnp.where(convex > 0, hvv - ratio * huv, jnp.abs(hvv)) <= FLATTEST * gram[1]
    first = jnp.where(raised_u, 0.0, jnp.where(huu < 0, -1.0, 1.0)) * dh[0]
    mixed = convex * dh[1]
    whole = jnp.where((convex > 0) | (hvv > 0), dh[2], -dh[2]) * (dv - push * across)
    second = jnp.where(raised_v, ratio * (2 * mixed - ratio * first) * dv, whole)
    right_u = dg[0] + first * free + mixed * dv
    right_v = dg[1] + mixed * free + second
    ddv = (ratio * right_u - right_v) * over_v + push * dl[1]
    ddv = jnp.where(jnp.abs(dv) < across, ddv, jnp.sign(dv) * dl[1])
    ddu = -right_u * over_u - ratio * ddv
    ddu = jnp.where(jnp.abs(du) < along, ddu, jnp.sign(du) * dl[0])
    none = jnp.zeros_like(du)
    return step, DescentStep(ddu, ddv, none, none, none, none)
