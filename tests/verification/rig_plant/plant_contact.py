"""The plant's contact: a sphere on the true implant, by a search for closest points at every evaluation (NumPy).

The squared distance phi = |S - c|^2 / 2 from the sphere's centre c to the implant's surface S(u, v) is stationary at
the closest points and at the ridges between two of them. The search first minimises phi over u for each v across the
groove. The slope of the remaining function of v is sampled over the sphere's width. Each change of its sign is a
minimum, which is a contact, or a maximum, the ridge between two; Newton's method on phi refines it to rounding error.

The stored energy is the sum of V(indentation) over the minima minus that over the ridges: when two contacts merge,
their shared part counts once, and no force jumps. The force is the gradient of that energy: a ridge is a contact with
the weight -1 along its own normal.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SAMPLES = np.linspace(-0.9, 0.9, 46)  # across the groove, in radii from the sphere's centre
FINER = 8  # subdivisions of a sample interval, by cubic interpolation, that separate changes of sign
NEAR = 1e-4  # stationary points with a larger gap are ignored [m]
ALONG = 1e-5  # tolerance of u before the slope is corrected [m]
EXACT = 1e-7  # step at which Newton's method stops; the remaining error is ten thousand times smaller [m]
LONGEST = 2e-3  # longest step of Newton's method [m]
IMAGINARY, APART = 1e-30, 1e-6  # complex step and finite-difference step of the derivatives [m]
_U = np.array([IMAGINARY * 1j, 0, APART + IMAGINARY * 1j, APART, 0])[:, None]
_V = np.array([0, IMAGINARY * 1j, 0, IMAGINARY * 1j, APART + IMAGINARY * 1j])[:, None]
_T = (np.arange(FINER) / FINER)[:, None]
_HERMITE = np.hstack([(1 + 2 * _T) * (1 - _T) ** 2, _T * (1 - _T) ** 2, _T**2 * (3 - 2 * _T), _T**2 * (_T - 1)])


class Stationary(NamedTuple):
    """A point of the surface where the distance to the sphere's centre is stationary."""

    sign: float  # +1: contact; -1: ridge between two contacts
    distance: float  # [m]
    normal: NDArray  # (3,) unit vector from the surface to the centre, femur axes


class ImplantContact:
    """Contact of a sphere of given radius [m] with an implant; `shape` has the fields of `FemoralComponent`."""

    def __init__(self, shape: SimpleNamespace, radius: float) -> None:
        self.shape, self.radius = shape, radius
        self._lean = np.zeros(SAMPLES.size)  # u of the last search, as a warm start

    def height(self, u: NDArray, v: NDArray) -> NDArray:
        """Returns the distance of the surface from the trochlear axis [m]; u and v [m] may be complex."""
        m = self.shape
        angle = u / m.trochlear_radius
        proximal = _rise((angle - m.sulcus_transition) / m.sulcus_blend)
        blend = m.sagittal_blend
        groove = (
            _arc(blend * _ramp((angle - m.flange_angle) / blend), m.trochlear_radius, m.flange_radius)
            + _arc(blend * _ramp((m.distal_angle - angle) / blend), m.trochlear_radius, m.distal_radius)
            - m.trochlear_radius
        )
        y = v - np.tan(m.groove_obliquity) * u
        slope = 1 / np.tan(0.5 * (m.sulcus_angle + (m.sulcus_angle_proximal - m.sulcus_angle) * proximal))
        waist = m.groove_radius * slope
        across = slope * (np.sqrt(y * y + waist * waist) - waist + m.lateral_steepness * y)
        ridge = m.facet_width + m.facet_widening * proximal
        for side in (1, -1):
            fall = slope * (1 + side * m.lateral_steepness) + m.outer_slope
            across = across - fall * m.ridge_blend * _ramp((side * y - ridge) / m.ridge_blend)
        notch = m.notch_depth * _rise((m.notch_angle - angle) / m.notch_blend)
        return groove + across - notch * np.exp(-((v / m.notch_half_width) ** 2))

    def half_square(self, c: NDArray, u: NDArray, v: NDArray) -> NDArray:
        """Returns phi = |S - c|^2 / 2 [m^2] for a point c in the femur frame [m]."""
        height, angle = self.height(u, v), u / self.shape.trochlear_radius
        x, z = height * np.sin(angle) - c[0], height * np.cos(angle) - c[2]
        return 0.5 * (x * x + (v - c[1]) ** 2 + z * z)

    def _derivatives(self, c: NDArray, u: NDArray, v: NDArray) -> tuple[NDArray, ...]:
        """phi, its gradient (exact, from complex steps) and its Hessian uu, uv, vv (finite differences of that)."""
        phi = self.half_square(c, u + _U, v + _V)
        of_u, of_v, of_u_on, of_v_on, of_v_across = np.imag(phi) / IMAGINARY
        return (
            np.real(phi[0]),
            of_u,
            of_v,
            (of_u_on - of_u) / APART,
            (of_v_on - of_v) / APART,
            (of_v_across - of_v) / APART,
        )

    def stationary(self, c: NDArray) -> list[Stationary]:
        """Returns the contacts of a sphere with its centre at c [m] (femur frame), and the ridges between them."""
        v = c[1] + self.radius * SAMPLES
        phi, slope, curvature, u, step = self._section(c, v)
        for _ in range(50):
            if step < ALONG:
                break
            phi, slope, curvature, u, step = self._section(c, v)
        spacing, rise = v[1] - v[0], (v[1] - v[0]) * curvature
        fine = (_HERMITE @ np.stack([slope[:-1], rise[:-1], slope[1:], rise[1:]])).T.ravel()
        changes = np.flatnonzero((fine[:-1] < 0) != (fine[1:] < 0))
        at = v[0] + spacing / FINER * (changes + fine[changes] / (fine[changes] - fine[changes + 1]))
        near = np.interp(at, v, phi) < 0.5 * (self.radius + NEAR) ** 2
        return self._placed(c, np.interp(at, v, u)[near], at[near], np.sign(-fine[changes])[near])

    def _section(self, c: NDArray, v: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, float]:
        """phi, slope and curvature along v, each at the minimising u; that u; and the longest step taken in u."""
        foot = self.shape.trochlear_radius * np.arctan2(c[0], c[2])
        phi, of_u, of_v, uu, uv, vv = self._derivatives(c, foot + self._lean, v)
        step = _limited(-of_u / np.maximum(uu, 0.1))
        self._lean = self._lean + step
        return phi, of_v - uv * of_u / uu, vv - uv * uv / uu, foot + self._lean, float(np.abs(step).max())

    def _placed(self, c: NDArray, u: NDArray, v: NDArray, signs: NDArray) -> list[Stationary]:
        """Refines stationary points with Newton's method."""
        if not u.size:
            return []
        for _ in range(12):
            _, of_u, of_v, uu, uv, vv = self._derivatives(c, u, v)
            det = uu * vv - uv * uv
            du, dv = _limited((uv * of_v - vv * of_u) / det), _limited((uv * of_u - uu * of_v) / det)
            u, v = u + du, v + dv
            if max(np.abs(du).max(), np.abs(dv).max()) < EXACT:
                break
        height, angle = self.height(u, v), u / self.shape.trochlear_radius
        away = c - np.stack([height * np.sin(angle), v, height * np.cos(angle)], axis=1)
        return [
            Stationary(sign, d, a / d)
            for sign, a, d in zip(signs.tolist(), away, np.sqrt((away**2).sum(axis=1)).tolist(), strict=True)
        ]


def _limited(step: NDArray) -> NDArray:
    """Limits a step to plus or minus `LONGEST`."""
    return np.minimum(np.maximum(step, -LONGEST), LONGEST)


def _rise(x: NDArray) -> NDArray:
    """Logistic function: a smooth step from 0 to 1."""
    return 1 / (1 + np.exp(-x))


def _ramp(x: NDArray) -> NDArray:
    """Softplus function: a smooth max(0, x), the integral of `_rise`."""
    return np.log1p(np.exp(x))


def _arc(turn: NDArray, inner: float, radius: float) -> NDArray:
    """Polar radius of a circle of `radius` at angle `turn` from where it touches the circle `inner` about the pole."""
    offset = inner - radius
    return offset * np.cos(turn) + np.sqrt(radius * radius - (offset * np.sin(turn)) ** 2)
