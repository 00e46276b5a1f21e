"""The taut line around an ellipsoid, approximated by the shortest planar one.

Coordinates are scaled so that the ellipsoid is the unit sphere, whose plane sections are circles with tangents in
closed form. Lengths are those of the vectors scaled back.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Quaternion, Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle, TautLine, evenly, straight, where

NODES = 5  # Gauss-Legendre nodes along each half of the arc
LEAST_STEP, LONGEST_STEP, MOST_STEPS = 1e-5, 0.4, 12  # Newton's method for the plane's angle [rad], [rad], [-]
FLAT = 1e-14  # second derivative of the length that is rounding error: the line hardly touches [m]


class Ellipsoid(Obstacle):
    r"""An ellipsoid.

    In each plane through both ends the line is two tangents with an arc between them. With t the plane's angle about
    the straight line, L is the smallest L(t) on the side on which the straight line passes the centre. The direction at
    an end p is minus dL/dp, so that force and energy are consistent.
    """

    radii: Vec3 = eqx.field(metadata=quantity("m", positive=True))
    orientation: Quaternion  # of its axes in the body's frame

    def around(self, start: Vec3, end: Vec3) -> TautLine:
        """See `Obstacle`."""
        touches, chord = self._chord(start, end)
        turn = _shortest(chord)
        length, backwards = jax.vjp(lambda s, e: self._chord(s, e)[1].length(turn), start, end)
        at_start, at_end = backwards(jnp.ones_like(length))
        return where(touches, TautLine(length, -at_start, -at_end), straight(start, end))

    def arc(self, start: Vec3, end: Vec3, count: int) -> Vec3:
        """See `Obstacle`: evenly divided where the ellipsoid is the unit sphere."""
        touches, p, q = self._ends(start, end)
        chord = _Chord.of(p, q, self.radii)
        turn = _shortest(chord)
        level, off, radius = chord.section(turn)
        first, last = (jnp.arctan2(along, up) for up, along in chord.touched(level, radius))
        x, y, z = _axes(p, q)
        c, s, r = jnp.cos(turn), jnp.sin(turn), self.radii

        def at(share: Scalar) -> Vec3:
            angle = first + share * (last - first)
            circle = (y * c + z * s) * jnp.cos(angle) + x * jnp.sin(angle)
            point = (z * c - y * s) * off + circle * radius
            return self.center + self.orientation.rotation().apply(Vec3(r.x * point.x, r.y * point.y, r.z * point.z))

        return evenly(at, count, touches)

    def depth(self, point: Vec3) -> Scalar:
        """See `Obstacle`."""
        r = self.radii
        return (1 - self._stretched(point).norm()) * jnp.minimum(jnp.minimum(r.x, r.y), r.z)

    def _stretched(self, point: Vec3) -> Vec3:
        """The point relative to the centre, in the coordinates in which the ellipsoid is the unit sphere."""
        p, r = self.orientation.rotation().unapply(point - self.center), self.radii
        return Vec3(p.x / r.x, p.y / r.y, p.z / r.z)

    def _chord(self, start: Vec3, end: Vec3) -> tuple[Scalar, _Chord]:
        """Whether the straight line passes through, and its chord, as of `_ends`."""
        touches, p, q = self._ends(start, end)
        return touches, _Chord.of(p, q, self.radii)

    def _ends(self, start: Vec3, end: Vec3) -> tuple[Scalar, Vec3, Vec3]:
        """Whether the straight line passes through, and its stretched ends; substitutes for which it does if not."""
        p, q = self._stretched(start), self._stretched(end)
        line = q - p
        squared, ahead = line.squared_norm(), -p.dot(line)
        nearest = p.squared_norm() * squared - jnp.square(ahead)
        touches = (ahead > 0) & (ahead < squared) & (nearest < squared) & (p.squared_norm() > 1)
        touches = touches & (q.squared_norm() > 1)

        def instead(point: Vec3, x: float) -> Vec3:
            pairs = zip((point.x, point.y, point.z), (x, 0.3, 0.1), strict=True)
            return Vec3(*(jnp.where(touches, own, other) for own, other in pairs))

        return touches, instead(p, -2.0), instead(q, 2.0)


def _axes(p: Vec3, q: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Unit vectors: x from p to q, and y and z perpendicular to it."""
    line = q - p
    x = line * (1 / line.norm())
    return x, *x.perpendiculars()


class _Chord(NamedTuple):
    """A line through the unit sphere along x, with both ends outside; y and z are perpendicular to it.

    A plane of angle `turn` contains x and t = y cos(turn) + z sin(turn), the direction from the line to the arc.
    """

    start: Scalar  # coordinates of the ends along x
    end: Scalar
    aside: tuple[Scalar, Scalar]  # the line's coordinates along y and z
    tangents: tuple[Scalar, Scalar]  # lengths of the tangents from the ends
    along: Scalar  # scalar products of x, y and z scaled back: xx [m^2]
    mixed: tuple[Scalar, Scalar]  # xy, xz
    across: tuple[Scalar, Scalar, Scalar]  # yy, yz, zz
    outward: tuple[Scalar, Scalar, Scalar]  # of y and z divided by the squared radii: yy, yz, zz [1/m^2]

    @staticmethod
    def of(p: Vec3, q: Vec3, radii: Vec3) -> _Chord:
        """The chord between two points."""
        x, y, z = _axes(p, q)
        dx, dy, dz = (Vec3(radii.x * v.x, radii.y * v.y, radii.z * v.z) for v in (x, y, z))
        ny, nz = (Vec3(v.x / radii.x, v.y / radii.y, v.z / radii.z) for v in (y, z))
        return _Chord(
            p.dot(x),
            q.dot(x),
            (p.dot(y), p.dot(z)),
            (jnp.sqrt(p.squared_norm() - 1), jnp.sqrt(q.squared_norm() - 1)),
            dx.squared_norm(),
            (dx.dot(dy), dx.dot(dz)),
            (dy.squared_norm(), dy.dot(dz), dz.squared_norm()),
            (ny.squared_norm(), ny.dot(nz), nz.squared_norm()),
        )

    def section(self, turn: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Circle in which a plane cuts the sphere: the line's coordinate along t, the plane's distance, the radius."""
        c, s = jnp.cos(turn), jnp.sin(turn)
        off = self.aside[1] * c - self.aside[0] * s
        return self.aside[0] * c + self.aside[1] * s, off, jnp.sqrt(1 - jnp.square(off))

    def touched(self, level: Scalar, radius: Scalar) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Tangent points of start and end on a plane's circle: along t and x, from the circle's centre, in radii."""

        def touch(end: Scalar, tangent: Scalar) -> tuple[Scalar, Scalar]:
            squared = jnp.square(level) + jnp.square(end)
            return (level * radius - end * tangent) / squared, (end * radius + level * tangent) / squared

        return touch(self.start, self.tangents[0]), touch(self.end, -self.tangents[1])

    def length(self, turn: Scalar) -> Scalar:
        """Length of the taut line in the plane of an angle [m]."""
        level, _, radius = self.section(turn)
        c, s = jnp.cos(turn), jnp.sin(turn)
        mixed = self.mixed[0] * c + self.mixed[1] * s
        across = self.across[0] * c * c + 2 * self.across[1] * s * c + self.across[2] * s * s

        def stretch(c: Scalar, s: Scalar) -> Scalar:
            """Length of x c - t s, scaled back: the tangent of the circle at t c + x s."""
            return jnp.sqrt(self.along * c * c - 2 * mixed * s * c + across * s * s)

        first, last = self.touched(level, radius)
        middle = first[0] + last[0], first[1] + last[1]
        size = jnp.sqrt(jnp.square(middle[0]) + jnp.square(middle[1]))
        middle = middle[0] / size, middle[1] / size
        half = first[0] * middle[1] - first[1] * middle[0]  # sine of half the arc

        # The nodes are a leading axis: unrolled, second derivatives take minutes to compile.
        share, weight = (a.reshape(-1, *[1] * jnp.ndim(half)) for a in _quadrature())

        def inner(end: tuple[Scalar, Scalar]) -> Scalar:
            """Length of the arc from its middle to an end, divided by `radius * half`."""
            c, s = (m[None] + share * (e - m)[None] for m, e in zip(middle, end, strict=True))
            squared = c * c + s * s
            stretched = jnp.sqrt(self.along[None] * c * c - 2 * mixed[None] * s * c + across[None] * s * s)
            return jnp.sum(weight * stretched / (squared * jnp.sqrt(squared)), axis=0)

        arc = inner(first) + inner(last)
        return self.tangents[0] * stretch(*first) + radius * half * arc + self.tangents[1] * stretch(*last)

    def outward_turn(self, y: Scalar, z: Scalar) -> Scalar:
        """Angle of the plane with the ellipsoid's normal at a point of coordinates y and z [rad]."""
        yy, yz, zz = self.outward
        return jnp.arctan2(yz * y + zz * z, yy * y + yz * z)


def _quadrature() -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return 0.5 + 0.5 * nodes, 0.5 * weights


@jax.custom_jvp
def _shortest(chord: _Chord) -> Scalar:
    """Angle of the plane in which the line is shortest [rad].

    That plane nearly contains the surface normal at the middle of the arc, which gives a start by fixed-point
    iteration; Newton's method then finds the zero of the slope.
    """
    turn = chord.outward_turn(*chord.aside)
    for _ in range(2):
        _, off, radius = chord.section(turn)
        c, s = jnp.cos(turn), jnp.sin(turn)
        turn = chord.outward_turn(radius * c - off * s, radius * s + off * c)

    def going_on(at: tuple[Scalar, Scalar, int]) -> Scalar:
        return (jnp.max(jnp.abs(at[1])) > LEAST_STEP) & (at[2] < MOST_STEPS)

    def go_on(at: tuple[Scalar, Scalar, int]) -> tuple[Scalar, Scalar, int]:
        turn, _, count = at
        slope, curvature = _slopes(chord, turn)
        step = jnp.clip(-slope / (jnp.abs(curvature) + FLAT), -LONGEST_STEP, LONGEST_STEP)
        return turn + step, step, count + 1

    return jax.lax.while_loop(going_on, go_on, (turn, jnp.ones_like(turn), 0))[0]


@_shortest.defjvp
def _follow(chords: tuple[_Chord], changes: tuple[_Chord]) -> tuple[Scalar, Scalar]:
    """Implicit differentiation: the slope stays zero."""
    turn = _shortest(*chords)
    _, curvature = _slopes(*chords, turn)
    _, change = jax.jvp(lambda chord: _slope(chord, turn), chords, changes)
    return turn, -change / (jnp.abs(curvature) + FLAT)


def _slope(chord: _Chord, turn: Scalar) -> Scalar:
    """Derivative of the length by the plane's angle [m]."""
    return jax.jvp(chord.length, (turn,), (jnp.ones_like(turn),))[1]


def _slopes(chord: _Chord, turn: Scalar) -> tuple[Scalar, Scalar]:
    """First and second derivative of the length by the plane's angle [m]."""
    return jax.jvp(lambda t: _slope(chord, t), (turn,), (jnp.ones_like(turn),))
