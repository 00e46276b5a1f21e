"""Check that contact stays on the spherical dome of a button: the angle of each contact point from the dome's apex."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinWarning

if TYPE_CHECKING:
    from pftwin.geometry.patch.sphere import SphereFit
    from pftwin.results.result import Result

_FACETS = ("medial", "lateral")


@dataclass(frozen=True, eq=False)
class CapUse:
    """Location of each facet's contact on the button's dome at every frame; the columns are medial and lateral."""

    angle: Floats  # (n, 2) at the sphere's centre, from the dome's axis to the contact point [rad]; NaN: no load
    force: Floats  # (n, 2) normal force [N]
    half_angle: float  # half opening angle of the spherical dome [rad]

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Whether each contact is loaded and lies outside the dome (n, 2)."""
        return self.angle > self.half_angle

    @property
    def frames(self) -> int:
        """Number of frames with a loaded contact outside the dome."""
        return int(self.beyond.any(axis=1).sum())

    @property
    def load_share(self) -> float:
        """Share of the normal force, summed over all frames, that is carried outside the dome."""
        total = float(self.force.sum())
        return float(self.force[self.beyond].sum()) / total if total > 0 else 0.0

    def describe(self) -> str:
        """Describes in one sentence whether contact stayed on the dome."""
        limit = np.degrees(self.half_angle)
        if not np.isfinite(self.angle).any():
            return "the button touched nothing"
        worst = np.degrees(np.nanmax(self.angle))
        if not self.frames:
            return f"every contact lay on the cap, at most {worst:.0f} deg of {limit:.0f} deg from its apex"
        return (
            f"contact left the button's spherical cap ({limit:.0f} deg about its apex) in {self.frames} of "
            f"{len(self.angle)} frames, by up to {worst - limit:.0f} deg; {100 * self.load_share:.0f} % of the load "
            "was carried there"
        )


def cap_use(result: Result, cap: SphereFit) -> CapUse:
    """Computes where the contacts of a simulation lie on the button's dome, fitted in the patella's frame.

    Raises InputError for a scene without sphere contact and for an axis that is not a unit vector.
    """
    if result.contact is None:
        raise InputError("no sphere contact", where=result.scene_name, remedy="add a SphereContact to the scene")
    axis = np.asarray(cap.axis, dtype=np.float64)
    if axis.shape != (3,) or not abs(np.linalg.norm(axis) - 1) < 1e-6:
        raise InputError(f"{axis} is no unit vector", where="cap.axis", expected="a direction in the patella's frame")
    from scipy.spatial.transform import Rotation

    report = result.effects[result.contact]
    apex = Rotation.from_quat(result.quaternion, scalar_first=True).apply(axis)
    force = np.stack([report[f"force_{facet}"] for facet in _FACETS], axis=1)
    arm = np.stack([report[f"point_{facet}"] for facet in _FACETS], axis=1) - result.center[:, None]  # NaN: no touch
    cosine = np.einsum("ijk,ik->ij", arm, apex) / np.linalg.norm(arm, axis=2)
    angle = np.where(force > 0, np.arccos(np.clip(cosine, -1, 1)), np.nan)
    return CapUse(angle, np.where(force > 0, force, 0.0), cap.cap_half_angle)


def check_cap(result: Result, cap: SphereFit) -> CapUse:
    """Returns `cap_use` and issues a PftwinWarning if a loaded contact lies outside the dome."""
    use = cap_use(result, cap)
    if use.frames:
        warnings.warn(
            f"{result.scene_name}: {use.describe()}, where the true button is no sphere of radius "
            f"{1e3 * cap.radius:.2f} mm. Try: a sphere fitted to the part of the button that bears load, "
            "or judge by the load carried there whether the answer is good enough.",
            PftwinWarning,
            stacklevel=2,
        )
    return use
