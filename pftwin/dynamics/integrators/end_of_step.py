"""Solver for the change of velocity over a step under forces that depend on it, and for the impulses of those forces.

With M the mass matrix (plus terms that act like mass), R the impulse of the constant forces, and terms along wrench
directions g_i whose impulses decrease with the change of velocity,

    M dv = R + sum_i g_i p_i,        p_i = P_i - w_i g_i . dv,        p_i >= 0 where the term is unilateral,

the p_i are solved for first: (I + W G^T M^-1 G) p = P - W G^T M^-1 R, with one row per term, by elimination without
pivoting (all leading minors are at least 1, since W >= 0 and M is positive definite). Bilateral terms come first, so
that only the small remainder is solved again when unilateral terms that would pull are removed.

Derivatives are those of the solution, not of the algorithm: differentiated at the solution, both equations are the same
system with other right-hand sides, which costs a fraction of differentiating the elimination.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.spatial import Scalar
from pftwin.dynamics.solve import Lower, eliminate, factor, solve

Row = Sequence[Scalar]  # six components: force in world axes, moment in patella axes


class ConstraintRow(NamedTuple):
    """Impulse of one scalar force in a step."""

    direction: Row  # g
    impulse: Scalar  # P: step times the force at unchanged velocity [N s]
    weight: Scalar  # w: decrease of the impulse per unit of g . dv, at least 0 [kg]
    unilateral: bool


class _Eliminated(NamedTuple):
    """I + W G^T M^-1 G with the bilateral columns eliminated."""

    swept: Sequence[Row]  # M^-1 g_i
    low: Lower | None  # M's factor, None where it is diagonal
    inverse: Row
    rows: list[list[Scalar]]  # row i: multipliers left of its first free column, then the eliminated matrix
    pivots: list[Scalar]  # inverse pivots of the bilateral rows
    n_bilateral: int


def _dot(a: Row, b: Row) -> Scalar:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _by_mass(low: Lower | None, inverse: Row, b: Row) -> list[Scalar]:
    """M^-1 b."""
    if low is None:
        return [x * d for x, d in zip(b, inverse, strict=True)]
    return solve(low, inverse, b)


def _eliminate(mass: Row | Lower, terms: Sequence[ConstraintRow]) -> _Eliminated:
    if isinstance(mass[0], list):
        low, inverse = factor(mass)  # type: ignore[arg-type]
    else:
        low, inverse = None, [1 / d for d in mass]  # type: ignore[operator]
    swept = [_by_mass(low, inverse, p.direction) for p in terms]
    r, m = len(terms), sum(not p.unilateral for p in terms)
    gram = {(i, j): _dot(terms[i].direction, swept[j]) for i in range(r) for j in range(i, r)}
    rows = [[p.weight * gram[min(i, j), max(i, j)] for j in range(r)] for i, p in enumerate(terms)]
    for i in range(r):
        rows[i][i] = rows[i][i] + 1
    pivots = []
    for k in range(m):
        pivots.append(1 / rows[k][k])
        for i in range(k + 1, r):
            rows[i][k] = rows[i][k] * pivots[k]
            for j in range(k + 1, r):
                rows[i][j] = rows[i][j] - rows[i][k] * rows[k][j]
    return _Eliminated(swept, low, inverse, rows, pivots, m)


def _free(e: _Eliminated, active: list[Scalar] | None, t: list[Scalar]) -> list[Scalar]:
    """Impulses of the unilateral terms by Gaussian elimination; zero for inactive terms."""
    n, m = len(t), e.n_bilateral
    a = [[e.rows[m + i][m + j] for j in range(n)] for i in range(n)]
    if active is not None:
        a = [
            [jnp.where(on, x, float(i == j)) for j, x in enumerate(row)]
            for i, (on, row) in enumerate(zip(active, a, strict=True))
        ]
        t = [jnp.where(on, x, 0.0) for on, x in zip(active, t, strict=True)]
    return eliminate(a, t)[0]


def _impulses(
    e: _Eliminated, terms: Sequence[ConstraintRow], rest: Row, given: Row, active: list[Scalar] | None
) -> tuple[list[Scalar], list[Scalar], list[Scalar] | None]:
    """dv and p for right-hand sides R = `rest`, P = `given`, and which unilateral terms push (computed if None)."""
    m = e.n_bilateral
    dv = _by_mass(e.low, e.inverse, rest)
    t = [x - p.weight * _dot(p.direction, dv) for p, x in zip(terms, given, strict=True)]
    for k in range(m):
        t = [x - e.rows[i][k] * t[k] if i > k else x for i, x in enumerate(t)]
    if active is None:
        tried = _free(e, None, t[m:])
        active = [x > 0 for x in tried]
    p = t[:m] + _free(e, active, t[m:])
    for k in reversed(range(m)):
        x = t[k]
        for j in range(k + 1, len(p)):
            x = x - e.rows[k][j] * p[j]
        p[k] = x * e.pivots[k]
    for swept, impulse in zip(e.swept, p, strict=True):
        dv = [v + impulse * s for v, s in zip(dv, swept, strict=True)]
    return dv, p, active


@eqx.filter_custom_jvp
def end_of_step(mass: Row | Lower, terms: Sequence[ConstraintRow], rest: Row) -> tuple[list[Scalar], list[Scalar]]:
    """Returns the change of velocity (six components) and the impulse of every term.

    Args:
        mass: M, as its diagonal or its lower triangle.
        terms: forces to be resolved at the end of the step, bilateral ones first.
        rest: R [N s, N m s].
    """
    dv, p, _ = _impulses(_eliminate(mass, terms), terms, rest, [x.impulse for x in terms], None)
    return dv, p


@end_of_step.def_jvp
def _end_of_step_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """M d(dv) = dR - dM dv + sum dg_i p_i + sum g_i dp_i, and likewise for p: the same system."""
    mass, terms, rest = primals
    d_mass, d_terms, d_rest = tangents
    e = _eliminate(mass, terms)
    dv, p, active = _impulses(e, terms, rest, [x.impulse for x in terms], None)
    zero = jnp.zeros_like(dv[0])
    right = [zero if d is None else d for d in d_rest]
    for i, row in enumerate(d_mass):
        if not isinstance(row, list):
            right[i] = right[i] if row is None else right[i] - row * dv[i]
            continue
        for j, d in enumerate(row):
            if d is not None:
                right[i] = right[i] - d * dv[j]
                if i != j:
                    right[j] = right[j] - d * dv[i]
    given = []
    for term, d, impulse in zip(terms, d_terms, p, strict=True):
        x = zero if d.impulse is None else d.impulse
        if d.weight is not None:
            x = x - d.weight * _dot(term.direction, dv)
        turned = [(i, t) for i, t in enumerate(d.direction) if t is not None]
        for i, t in turned:
            right[i] = right[i] + t * impulse
        if turned:
            x = x - term.weight * sum((t * dv[i] for i, t in turned), start=zero)
        given.append(x)
    d_dv, d_p, _ = _impulses(e, terms, right, given, active)
    return (dv, p), (d_dv, d_p)
