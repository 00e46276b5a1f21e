"""The plant's contact: a sphere on the true implant, searched for anew at every instant. NumPy alone.

Where the implant's surface S(u, v) is nearest to the sphere's centre c, and where it is farthest between two such
places, phi = |S - c|^2 / 2 is stationary. For each v across the groove the u of least phi is found first; what is left
is a function of v alone, whose slope is sampled over the sphere's width. Every change of its sign is a minimum, a
contact, or a maximum, the ridge between two contacts; Newton's method on phi then places it to rounding.

The stored energy is the sum over the minima of V(indentation) less that over the ridges: of two contacts that grow
into one, what they share counts once, and no force jumps where they meet. The force is the slope of that energy: a
ridge is a contact that counts -1, along its own normal.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SAMPLES = np.linspace(-0.9, 0.9, 46)  # across the groove, in radii from the sphere's centre
FINER = 8  # parts of a sample's spacing, by cubic interpolation, in which two changes of sign are told apart
NEAR = 1e-4  # farther than this from touching, a stationary point is left out [m]
ALONG = 1e-5  # how well u is found before its slope is corrected [m]
EXACT = 1e-7  # the last step of Newton's method, after which it is ten thousand times as near [m]
LONGEST = 2e-3  # its longest step [m]
IMAGINARY, APART = 1e-30, 1e-6  # steps of the derivatives [m]
_U = np.array([IMAGINARY * 1j, 0, APART + IMAGINARY * 1j, APART, 0])[:, None]
_V = np.array([0, IMAGINARY * 1j, 0, IMAGINARY * 1j, APART + IMAGINARY * 1j])[:, None]
_T = (np.arange(FINER) / FINER)[:, None]
_HERMITE = np.hstack([(1 + 2 * _T) * (1 - _T) ** 2, _T * (1 - _T) ** 2, _T**2 * (3 - 2 * _T), _T**2 * (_T - 1)])


class Stationary(NamedTuple):
    """A place of the surface where the distance to the sphere's centre is stationary."""

    sign: float  # +1 a contact, -1 the ridge between two
    distance: float  # [m]
    normal: NDArray  # from the surface to the centre, femur axes


class ImplantContact:
    """A sphere of a radius [m] against the implant that fields of `FemoralComponent` describe."""

    def __init__(self, shape: SimpleNamespace, radius: float) -> None:
        self.shape, self.radius = shape, radius
        self._lean = np.zeros(SAMPLES.size)  # where the last search found u; it speeds up the next

    def height(self, u: NDArray, v: NDArray) -> NDArray:
        """Distance of the surface from the trochlear axis [m]; analytic, so u and v may be complex."""
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
        """phi = |S - c|^2 / 2 for a point c of the femur [m^2]."""
        height, angle = self.height(u, v), u / self.shape.trochlear_radius
        x, z = height * np.sin(angle) - c[0], height * np.cos(angle) - c[2]
        return 0.5 * (x * x + (v - c[1]) ** 2 + z * z)

    def _derivatives(self, c: NDArray, u: NDArray, v: NDArray) -> tuple[NDArray, ...]:
        """phi, its gradient (exact, by complex steps) and its Hessian uu, uv, vv (by differences of that)."""
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
        """The contacts of a sphere with its centre at c (femur frame) [m], and the ridges between them."""
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
        """phi along v, its slope and curvature, each at the u of least phi; that u; the longest step taken to it."""
        foot = self.shape.trochlear_radius * np.arctan2(c[0], c[2])
        phi, of_u, of_v, uu, uv, vv = self._derivatives(c, foot + self._lean, v)
        step = _limited(-of_u / np.maximum(uu, 0.1))
        self._lean = self._lean + step
        return phi, of_v - uv * of_u / uu, vv - uv * uv / uu, foot + self._lean, float(np.abs(step).max())

    def _placed(self, c: NDArray, u: NDArray, v: NDArray, signs: NDArray) -> list[Stationary]:
        """Stationary points by Newton's method."""
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
    """A step held within the longest one."""
    return np.minimum(np.maximum(step, -LONGEST), LONGEST)


def _rise(x: NDArray) -> NDArray:
    """From 0 to 1, smoothly."""
    return 1 / (1 + np.exp(-x))


def _ramp(x: NDArray) -> NDArray:
    """0, then x, smoothly: the integral of `_rise`."""
    return np.log1p(np.exp(x))


def _arc(turn: NDArray, inner: float, radius: float) -> NDArray:
    """Polar distance of a circle of `radius`, `turn` past where it touches the circle of radius `inner` at the pole."""
    offset = inner - radius
    return offset * np.cos(turn) + np.sqrt(radius * radius - (offset * np.sin(turn)) ** 2)
