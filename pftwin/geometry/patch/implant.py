"""A parametric femoral component as a smooth surface, and triangle meshes of it.

Heights are distances from the trochlear axis on a `CylindricalChart`, made of smooth (C-infinity) functions only. So
the surface can replace a polynomial patch as the "true" implant: its `jet` is exact in value, gradient and Hessian.
Femur's frame: x proximal, y lateral (right knee), z anterior. Units are metres and radians.
"""

from __future__ import annotations

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.spatial import Rotation, Scalar, Vec3
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.charts import CylindricalChart, Jet
from pftwin.geometry.patch.closest import SurfaceProfile
from pftwin.geometry.patch.emphasis import WeightedPart
from pftwin.geometry.patch.region import TrochlearRegion, region_about

_DEG = math.pi / 180
_LENGTHS = ("trochlear_radius", "flange_radius", "distal_radius", "groove_radius", "facet_width", "ridge_blend")
_BOUNDS = {
    **dict.fromkeys((*_LENGTHS, "notch_half_width", "half_width"), (1e-4, 1.0)),  # [m]
    **dict.fromkeys(("sagittal_blend", "sulcus_blend", "notch_blend"), (0.1 * _DEG, 90 * _DEG)),
    **dict.fromkeys(("sulcus_angle", "sulcus_angle_proximal"), (90 * _DEG, 179.9 * _DEG)),
    "groove_obliquity": (-45 * _DEG, 45 * _DEG),
    "lateral_steepness": (-1.0, 1.0),
    "facet_widening": (-0.05, 0.05),
    "notch_depth": (0.0, 0.05),
    "outer_slope": (0.0, 10.0),
}

RIG_ANGLES = (-75 * _DEG, 42 * _DEG)
RIG_HALF_WIDTH = 22e-3  # for polynomials: to beyond the ridges, on which a dislocated button slides; wider patches lose
# the groove (over the whole component P5 has an error of 0.5 mm where the patella tracks, and case 3 starts dislocated)
RIG_RIM = 32.1e-3  # for splines: the whole component, which is 32 mm wide to either side
# For splines, rms [m]: the mesh has no noise, and a spline with an error of 4 um shifts the button's path by 0.06 to
# 0.13 mm.
RIG_TOLERANCE = 1e-6
RIG_PARTS = (  # for polynomials: weights where the button tracks, larger ones where it dislocates, as in the paper
    WeightedPart(0.1),
    WeightedPart(1.0, across=(-16e-3, 16e-3)),
    WeightedPart(3.0, angles=(-10 * _DEG, RIG_ANGLES[1]), across=(10e-3, RIG_HALF_WIDTH)),
)


class FemoralComponent(eqx.Module):
    """A femoral component with a sagittal multi-radius arc, a trochlear groove between two facets, and a notch.

    The sagittal section consists of three arcs that join tangentially: the anterior flange, the trochlea about its
    axis, and the distal arc. The transverse section of the groove is a hyperbola with the bottom radius
    `groove_radius`, whose flanks enclose the sulcus angle; beyond the facets' ridges the surface falls. The angle about
    the trochlear axis is 0 anteriorly, positive proximally. All fields are leaves, for derivatives and batches.
    """

    trochlear_radius: Scalar | float = 24.8e-3  # of the groove's bottom about the axis, sagittal [m]
    flange_radius: Scalar | float = 73.8e-3  # sagittal radius of the anterior flange [m]
    flange_angle: Scalar | float = 4.8 * _DEG  # where the flange begins [rad]
    distal_radius: Scalar | float = 33.8e-3  # sagittal radius of the groove's distal part [m]
    distal_angle: Scalar | float = -37.0 * _DEG  # where the distal arc begins [rad]
    sagittal_blend: Scalar | float = 6.0 * _DEG  # angle over which the radii change [rad]
    sulcus_angle: Scalar | float = 140.9 * _DEG  # between the flanks, distally [rad]
    sulcus_angle_proximal: Scalar | float = 151.1 * _DEG  # the same on the flange [rad]
    sulcus_transition: Scalar | float = -0.8 * _DEG  # where the sulcus angle is midway between the two [rad]
    sulcus_blend: Scalar | float = 11.8 * _DEG  # angle over which it changes [rad]
    groove_radius: Scalar | float = 15.9e-3  # transverse radius of the groove's bottom [m]
    lateral_steepness: Scalar | float = 0.119  # by which the lateral flank is steeper and the medial one flatter [-]
    groove_obliquity: Scalar | float = 5.6 * _DEG  # of the groove, lateral towards proximal [rad]
    facet_width: Scalar | float = 16.6e-3  # from the groove to the ridge of a facet, distally [m]
    facet_widening: Scalar | float = 2.2e-3  # additional facet width on the flange [m]
    ridge_blend: Scalar | float = 1.9e-3  # rounding of the ridges, a length across them [m]
    outer_slope: Scalar | float = 0.6  # slope of the falling surface beyond the ridges [-]
    notch_angle: Scalar | float = -77.8 * _DEG  # where the intercondylar notch has half its depth [rad]
    notch_blend: Scalar | float = 9.0 * _DEG  # angle over which it deepens [rad]
    notch_depth: Scalar | float = 5.5e-3  # below the groove's arc [m]
    notch_half_width: Scalar | float = 9.0e-3  # where its depth has fallen to 1/e [m]
    proximal_end: Scalar | float = 50.0 * _DEG  # of the component, as meshed [rad]
    distal_end: Scalar | float = -110.0 * _DEG  # [rad]
    half_width: Scalar | float = 32.0e-3  # of the component [m]

    @property
    def chart(self) -> CylindricalChart:
        """Chart about the trochlear axis, y of the femur's frame; u is arc length along the groove's bottom."""
        one, zero = jnp.ones(()), jnp.zeros(())
        axes = Rotation(Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
        return CylindricalChart(Vec3.zero(), axes, self.trochlear_radius * one)

    @property
    def center(self) -> tuple[Scalar, Scalar]:
        """Centre (u, v) of the component [m]."""
        return self.chart.radius * (0.5 * (self.proximal_end + self.distal_end)), jnp.zeros(())

    @property
    def half_size(self) -> tuple[Scalar, Scalar]:
        """Half the component's extent along u and v [m]."""
        return self.chart.radius * (0.5 * (self.proximal_end - self.distal_end)), self.half_width * jnp.ones(())

    def unstacked(self) -> FemoralComponent:
        """Returns itself; for compatibility with patches."""
        return self

    def clipped(self, v: Scalar) -> Scalar:
        """The coordinate v limited to the component [m]."""
        return jnp.clip(v, -self.half_width, self.half_width)

    def profile(self, u: Scalar) -> SurfaceProfile:
        """The surface along v at one u, by forward-mode differentiation."""

        def height_and_slope(v: Scalar) -> tuple[Scalar, Scalar]:
            return jax.jvp(lambda a: self.height(a, v), (u,), (jnp.ones_like(u),))

        return height_and_slope, lambda v: self.jet(u, v).uu

    def outside(self, u: Scalar, v: Scalar) -> Scalar:
        """Distance of a point beyond the component's edge [m]; zero inside."""
        (u0, v0), (half_u, half_v) = self.center, self.half_size
        return jnp.maximum(jnp.maximum(jnp.abs(u - u0) - half_u, 0.0), jnp.maximum(jnp.abs(v - v0) - half_v, 0.0))

    def height(self, u: Scalar, v: Scalar) -> Scalar:
        """Distance from the trochlear axis [m]."""
        angle = u / self.trochlear_radius
        proximal = jax.nn.sigmoid((angle - self.sulcus_transition) / self.sulcus_blend)
        return self._groove(angle) + self._across(v - self.groove_line(u), proximal) - self._notch(angle, v)

    def groove_line(self, u: Scalar) -> Scalar:
        """Medial-lateral position of the groove's bottom, positive lateral [m]."""
        return jnp.tan(self.groove_obliquity) * u

    def jet(self, u: Scalar, v: Scalar) -> Jet:
        """Height with exact first and second derivatives, by forward-mode differentiation."""
        one, zero = jnp.ones_like(u), jnp.zeros_like(v)

        def slope_u(a: Scalar, b: Scalar) -> tuple[Scalar, Scalar]:
            return jax.jvp(self.height, (a, b), (one, zero))

        def slope_v(a: Scalar, b: Scalar) -> Scalar:
            return jax.jvp(self.height, (a, b), (zero, one))[1]

        (f, fu), (_, fuu) = jax.jvp(slope_u, (u, v), (one, zero))
        fv, fuv = jax.jvp(slope_v, (u, v), (one, zero))
        fvv = jax.jvp(slope_v, (u, v), (zero, one))[1]
        return Jet(f, fu, fv, fuu, fuv, fvv)

    def mesh(self, *, deviation: float = 0.1e-3, angle: float | None = None) -> SurfaceMesh:
        """Makes a triangle mesh that deviates from the surface by at most `deviation` [m].

        The paper's coarse mesh has 0.1 mm (the default), its fine one 0.006 mm. `angle` [rad] additionally limits the
        angle between adjacent triangles along the grid, often the stricter limit: 1 deg requires a far finer mesh than
        0.1 mm.

        Raises:
            InputError: tolerances that are not positive or that require more than two million triangles.
        """
        from pftwin.geometry.patch.tessellate import tessellate

        self.check()
        return tessellate(self, deviation=deviation, angle=angle)

    def check(self) -> None:
        """Checks that the parameters give a valid component; for use on the host, before a simulation.

        Raises:
            InputError: an invalid parameter, with the name of its field.
        """
        for name in (f.name for f in dataclasses.fields(self)):
            low, high = _BOUNDS.get(name, (-math.pi, math.pi))
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if not (np.isfinite(value) & (value >= low) & (value <= high)).all():
                raise InputError(
                    f"{value} is out of range", where=f"FemoralComponent.{name}", expected=f"{low} to {high}"
                )
        if not np.all(np.asarray(self.distal_end) < np.asarray(self.proximal_end)):
            raise InputError("distal_end is not below proximal_end", where="FemoralComponent.distal_end")

    def _groove(self, angle: Scalar) -> Scalar:
        """Height of the groove's bottom: three arcs with common tangents."""
        r, w = self.trochlear_radius, self.sagittal_blend
        to_flange = w * jax.nn.softplus((angle - self.flange_angle) / w)
        to_distal = w * jax.nn.softplus((self.distal_angle - angle) / w)
        flange = _circle_polar_distance(to_flange, r, self.flange_radius)
        return flange + _circle_polar_distance(to_distal, r, self.distal_radius) - r

    def _across(self, y: Scalar, proximal: Scalar) -> Scalar:
        """Height above the groove's bottom at a distance y from it; `proximal` is 0 distally and 1 on the flange."""
        half_angle = self.sulcus_angle + (self.sulcus_angle_proximal - self.sulcus_angle) * proximal
        slope = 1 / jnp.tan(0.5 * half_angle)
        lateral, medial = slope * (1 + self.lateral_steepness), slope * (1 - self.lateral_steepness)
        waist = self.groove_radius * slope
        flanks = slope * (jnp.sqrt(y * y + waist * waist) - waist + self.lateral_steepness * y)
        ridge, e = self.facet_width + self.facet_widening * proximal, self.ridge_blend
        over_lateral, over_medial = e * jax.nn.softplus((y - ridge) / e), e * jax.nn.softplus((-y - ridge) / e)
        return flanks - (lateral + self.outer_slope) * over_lateral - (medial + self.outer_slope) * over_medial

    def _notch(self, angle: Scalar, y: Scalar) -> Scalar:
        """Depth of the intercondylar notch below the groove's arc."""
        distal = jax.nn.sigmoid((self.notch_angle - angle) / self.notch_blend)
        return self.notch_depth * distal * jnp.exp(-((y / self.notch_half_width) ** 2))


def _circle_polar_distance(turn: Scalar, inner: Scalar | float, radius: Scalar | float) -> Scalar:
    """Distance from the origin to a circle of `radius` at an angle `turn` past its tangent point with a circle of
    radius `inner` about the origin."""
    offset = inner - radius
    sine = offset * jnp.sin(turn)
    return offset * jnp.cos(turn) + jnp.sqrt(radius * radius - sine * sine)


def rig_implant() -> FemoralComponent:
    """The virtual rig's femoral component: the default parameters.

    They were tuned to the paper, so the agreement is no validation: polynomials P2, P4 and P5 over a plane, fitted with
    equal weights from 30 deg proximal to 75 deg distal and 20 mm to either side, have R^2 of 91.56, 99.38 and 99.70 %;
    those of the paper's implant have 91.54, 99.36 and 99.71 % (Michaud et al. 2024, section 2.4.2).
    """
    return FemoralComponent()


def rig_region(mesh: SurfaceMesh, *, half_width: float = RIG_HALF_WIDTH) -> TrochlearRegion:
    """The region of the rig implant's mesh that the patches are fitted to, with its charts.

    It extends from 42 deg proximal to 75 deg distal of the anterior direction: the button touches the true surface from
    35 deg proximal, in full extension, to 64 deg distal, at 88 deg of knee flexion. `half_width` [m]: see
    `RIG_HALF_WIDTH` and `RIG_RIM`.
    """
    return region_about(mesh, rig_implant().chart, angles=RIG_ANGLES, half_width=half_width)
