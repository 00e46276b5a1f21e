"""Tables of surfaces given by coefficients: a polynomial patch or a spline patch over a chart."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Rotation, Scalar
from pftwin.files.scene_file.effect_tables import Setting
from pftwin.files.scene_file.section import (
    Pair,
    Point,
    Polynomial,
    Positive,
    PositivePair,
    Section,
    UnitQuaternion,
    problem,
)
from pftwin.files.scene_file.side import HostPose
from pftwin.geometry.patch.charts import Chart, CylindricalChart, PlaneChart
from pftwin.geometry.patch.closest import Surface


class ChartSection(Section):
    """Coordinates of a patch: heights over a plane or about an axis."""

    type: Literal["plane", "cylinder"] = Field(description="heights over a plane, or about the frame's y axis")
    origin_m: Point = Field(default=[0.0, 0.0, 0.0], description="origin of the chart's frame, femur frame [m]")
    quaternion_wxyz: UnitQuaternion = Field(
        default=[1.0, 0.0, 0.0, 0.0], description="orientation of the chart's frame in the femur's (w, x, y, z)"
    )
    radius_m: Positive | None = Field(default=None, description="radius that makes the cylinder's angle a length [m]")

    def _check(self) -> None:
        if (self.type == "cylinder") != (self.radius_m is not None):
            raise problem(f"a {self.type} chart {'without' if self.type == 'cylinder' else 'with'} radius_m")

    def build(self, setting: Setting) -> Chart:
        """The chart. A mirrored chart keeps a right-handed frame by reversing its y axis: v changes its sign."""
        frame = HostPose.of(self.origin_m, self.quaternion_wxyz)
        origin = setting.side.points("femur", frame.position)
        axes = setting.side.matrices["femur"] @ frame.matrix * np.array([1.0, v_sign(setting), 1.0])
        where = vector(origin), Rotation.from_array(number(axes))
        return PlaneChart(*where) if self.radius_m is None else CylindricalChart(*where, number(self.radius_m))


def v_sign(setting: Setting) -> float:
    """Sign of v in the scene's chart: -1 for a left knee, else 1."""
    return -1.0 if setting.side.left else 1.0


class _RectangleSection(Section):
    """A rectangle of a chart."""

    chart: ChartSection = Field(description="table: the chart")
    center_m: Pair = Field(default=[0.0, 0.0], description="centre (u0, v0) of the patch's rectangle [m]")
    half_size_m: PositivePair = Field(description="half size (half_u, half_v) of the patch's rectangle [m]")

    def rectangle(self, setting: Setting) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Centre and half size in the scene's chart [m]."""
        center = number(self.center_m[0]), number(v_sign(setting) * self.center_m[1])
        return center, (number(self.half_size_m[0]), number(self.half_size_m[1]))


class PatchSurfaceSection(_RectangleSection):
    """A polynomial patch: height = sum of c_ij a^i b^j, with a = (u - u0) / half_u and b = (v - v0) / half_v."""

    coefficients_m: list[float] = Field(
        description="coefficients c_ij [m]: all i for j = 0, then all i for j = 1, ..., i + j up to the degree"
    )
    degree: Polynomial = Field(default="P5", description='polynomial: "P2", "P4", "P5" or another total degree')

    def build(self, setting: Setting) -> Surface:
        """The patch."""
        from pftwin.geometry.patch.fit import parse_degree
        from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents

        with setting.naming("degree"):
            degree = parse_degree(self.degree)
            refuse_other(setting, f"P{degree}")
        powers = exponents(degree)
        if len(self.coefficients_m) != len(powers):
            raise InputError(
                f"{len(self.coefficients_m)} coefficients",
                where=setting.where("coefficients_m"),
                expected=f"the {len(powers)} coefficients of P{degree}",
            )
        sign = v_sign(setting)  # also the sign of odd powers of v
        coefficients = [c * sign**j for c, (_, j) in zip(self.coefficients_m, powers, strict=True)]
        return PolynomialPatch(self.chart.build(setting), number(coefficients), *self.rectangle(setting), degree)


class SplineSurfaceSection(_RectangleSection):
    """A bicubic spline patch: height = sum of c_ij N_i(a) N_j(b), with uniform cubic B-splines N."""

    spline_coefficients_m: list[list[float]] = Field(
        description="coefficients c_ij [m]: one row for each i, along u; number of cells + 3 in both directions"
    )

    def _check(self) -> None:
        widths = {len(row) for row in self.spline_coefficients_m}
        if len(widths) != 1 or min(len(self.spline_coefficients_m), *widths) < 4:
            found = f"{len(self.spline_coefficients_m)} rows of {sorted(widths)} spline_coefficients_m"
            raise problem(found, expected="4 or more rows of one length, 4 or more")

    def build(self, setting: Setting) -> Surface:
        """The patch."""
        from pftwin.geometry.patch.fit import SPLINE
        from pftwin.geometry.patch.spline import SplinePatch

        with setting.naming():
            refuse_other(setting, SPLINE)
        rows = np.asarray(self.spline_coefficients_m, dtype=np.float64)
        rows = rows[:, ::-1] if setting.side.left else rows
        return SplinePatch(self.chart.build(setting), number(rows), *self.rectangle(setting))


def refuse_other(setting: Setting, name: str | None) -> None:
    """Raises InputError if the command line requests another patch, which would need a mesh to fit it to."""
    from pftwin.geometry.patch.fit import parse_name

    if setting.contact is not None and parse_name(setting.contact) != name:
        raise InputError(
            f"{setting.contact} was requested, but this surface is not fitted to a mesh",
            remedy="leave it as it is, or give the surface as a mesh",
        )
