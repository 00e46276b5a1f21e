"""[motion.joint_centers]: points that count as markers, fixed in a segment: given, or found from the motion."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pftwin.base.arrays import Floats
from pftwin.files.mocap import MarkerTrajectories, PoseSeries, sphere_center
from pftwin.files.scene_file.section import Point, Section, problem
from pftwin.model.limits import Limits, beyond


class JointCenterSection(Section):
    """A point that counts as a marker, for segments with two markers, say.

    It is fixed in a segment of this file or in a cluster of other markers, as on the pelvis. Its place there is given,
    or found as the point about which markers of the neighbouring segment turn, by least squares over the motion.
    """

    about: Literal["world", "femur", "tibia"] = Field(default="world", description="in what it is fixed")
    about_markers: Annotated[list[str], Field(min_length=3)] | None = Field(
        default=None, description="in place of `about`: three markers or more of a segment in which it is fixed"
    )
    point_m: Point | None = Field(default=None, description="its place in that segment's frame [m]")
    of: Annotated[list[str], Field(min_length=1)] | None = Field(
        default=None, description="in place of `point_m`: markers of the other segment, which turn about it"
    )

    def _check(self) -> None:
        if (self.point_m is None) == (self.of is None):
            found = "neither point_m nor of" if self.of is None else "both point_m and of"
            raise problem(found, expected="its place, point_m, or the markers that turn about it, of")
        if self.about_markers is not None and (self.point_m is not None or self.about != "world"):
            found = "about_markers beside " + ("about" if self.point_m is None else "point_m")
            raise problem(found, expected="about_markers with of alone, or about")

    def path(
        self, name: str, frame: PoseSeries, turning: MarkerTrajectories | None, limits: Limits, notes: list[str]
    ) -> Floats:
        """Its places (n, 3) in the world [m].

        Args:
            name: its own, for messages.
            frame: poses of the segment in which it is fixed.
            turning: the markers `of`; None for a point that is given.
            limits: how well the motion has to tell it.
            notes: what is found is said there.

        Raises:
            InputError: a motion that does not tell it well enough.
        """
        rotations = frame.matrices()
        if turning is None:
            return frame.positions + rotations @ np.array(self.point_m)
        local = np.einsum("nji,nmj->nmi", rotations, turning.positions - frame.positions[:, None])
        found = sphere_center(local, source=turning.source)
        markers, reach = ", ".join(turning.names), np.degrees(found.reach)
        if 1e3 * found.deviation > (most := limits.most_center_deviation_mm):
            told = f"to {1e3 * found.deviation:.3g} mm only" if np.isfinite(found.deviation) else "not at all, some way"
            words = f"{markers} turn about it by up to {reach:.2g} deg from their mean, which tells it {told}"
            raise beyond("most_center_deviation_mm", most, words, 1e3 * found.deviation)
        notes.append(
            f"{name}: {markers} turn about it by up to {reach:.0f} deg from their mean and keep their distance "
            f"within {1e3 * found.residual_rms:.2f} mm rms: told to {1e3 * found.deviation:.2f} mm (standard deviation)"
        )
        return frame.positions + rotations @ found.point
