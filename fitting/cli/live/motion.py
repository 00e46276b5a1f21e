"""A simulated motion as the page needs it: its numbers and words, and the arrays that are drawn. Femur frame, mm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.results.viewer.knee import REST, gaps_filled
from pftwin.results.viewer.line_shapes import line_shape
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM, Matrices, Shape, at_points, of_arrows, path, spaced_points

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

_REMEDY = "other values"


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """The numbers of one motion; series are at the frames that are shown (n,)."""

    recorded: Recorded
    dislocates: bool | None  # None: there is no groove to leave, or the motion may not be spoken of
    tracking: str  # in words, with times; "INVALID" and why where the motion may not be spoken of
    valid: bool  # whether it may
    status: str  # how far to trust it, in words
    finite: bool
    settled: bool  # whether it starts from an equilibrium
    tilt: Floats  # [deg]
    shift: Floats  # [mm]
    force: Floats  # of the contact [N]; NaN without one
    highest_force: float  # over all frames [N]
    seconds: float = 0.0  # from the treated scene to here

    @classmethod
    def of(cls, result: Result, name: str, geometry: Dataset) -> ShownMotion:
        """From a result, under a name for the legend, and what there is to draw of its scene."""
        from pftwin.dynamics.status import Status

        outcome = result.dislocations()
        recorded = Recorded.of(result, name, geometry=geometry)
        force = None if result.contact is None else recorded.series(f"{result.contact}_force")
        every = np.array([np.nan]) if force is None else np.asarray(result.effects[str(result.contact)]["force"])
        there = every[np.isfinite(every)]
        tilt, shift = recorded.series("patella_tilt"), recorded.series("patella_shift")
        assert tilt is not None
        assert shift is not None
        return cls(
            recorded,
            None if outcome is None else bool(outcome.events),
            result.tracking,
            result.verdict.valid,
            result.status.describe(),
            not (result.flags & int(Status.NOT_FINITE)).any(),
            bool(result.equilibrium.converged),
            tilt,
            1e3 * shift,
            np.full_like(tilt, np.nan) if force is None else force,
            float(there.max()) if there.size else float("nan"),
        )

    @property
    def times(self) -> Floats:
        """Of the frames that are shown (n,) [s]."""
        return self.recorded.times

    def named(self, name: str) -> ShownMotion:
        """The same under another name."""
        return replace(self, recorded=replace(self.recorded, name=name))

    def refuse_if_lost(self, unlike: ShownMotion | None = None) -> None:
        """Raises InputError for lost frames, and for a start without equilibrium where the untreated motion has one."""
        if not self.finite:
            raise InputError("the patella is lost in this motion (frames are not finite)", remedy=_REMEDY)
        if not self.settled and unlike is not None and unlike.settled:
            raise InputError("there is no static equilibrium to start from", remedy=_REMEDY)


@dataclass(frozen=True, eq=False)
class ShownTrack:
    """Place, rotation, size and presence of a drawn part at every frame (n)."""

    position: Floats  # (n, 3) [mm]
    wxyz: Floats  # (n, 4)
    scale: Floats  # (n,)
    present: NDArray[np.bool_]  # (n,)

    @classmethod
    def of(cls, matrices: Matrices, present: NDArray[np.bool_] | None = None) -> ShownTrack:
        """From model matrices (n, 4, 4), whose scale is the same along all axes."""
        from scipy.spatial.transform import Rotation

        turn = matrices[:, :3, :3].astype(np.float64)
        scale = np.linalg.norm(turn[:, :, 2], axis=1)
        wxyz = Rotation.from_matrix(turn / scale[:, None, None]).as_quat(scalar_first=True)
        there = np.ones(len(matrices), dtype=bool) if present is None else present
        return cls(matrices[:, :3, 3].astype(np.float64), wxyz, scale, there)


@dataclass(frozen=True, eq=False)
class Shown:
    """The drawing of one motion; each array is computed when it is first asked for."""

    recorded: Recorded
    newtons: float  # drawn as 10 mm of an arrow

    @cached_property
    def tracks(self) -> dict[str, ShownTrack]:
        """Of "patella" and "tibia"; of each facet's contact point, "at FACET", and force, "on FACET".

        A force is drawn by an arrow of length 1 along z.
        """
        found = {"patella": ShownTrack.of(self.recorded.patella), "tibia": ShownTrack.of(self.recorded.tibia)}
        for arrow in self.recorded.contact_arrows:
            here = arrow.present
            if not here.any():
                continue
            points = gaps_filled(arrow.points, here)
            if arrow.touches:
                found[f"at {arrow.name}"] = ShownTrack.of(at_points(points), here)
            if arrow.forces is not None:
                along = gaps_filled(arrow.forces, here) * (10 / self.newtons)
                found[f"on {arrow.name}"] = ShownTrack.of(of_arrows(points, along), here)
        return found

    @cached_property
    def lines(self) -> dict[str, tuple[NDArray[np.float32], NDArray[np.uint32]]]:
        """Tendons, ligaments and muscles: vertices (n, v, 3) and triangles, by name."""
        return {name: line_shape(lines) for name, lines in self.recorded.lines.items()}

    @cached_property
    def origins(self) -> dict[str, Floats]:
        """Mean origin on the tibia of each effect's lines, tibia frame (3,) [mm]."""
        on_tibia = {n: lines for n, lines in self.recorded.lines.items() if lines.body == "tibia"}
        return {n: MM * lines.origin.reshape(-1, 3).mean(axis=0) for n, lines in on_tibia.items()}

    @cached_property
    def paths(self) -> dict[str, Shape]:
        """The path of each contact point, "way FACET"."""
        found = {}
        for arrow in self.recorded.contact_arrows:
            points = MM * np.where(arrow.present[:, None], arrow.points, np.nan)
            taken = spaced_points(points, REST)
            if arrow.touches and taken.sum() > 1:
                found[f"way {arrow.name}"] = path(points[taken | ~arrow.present], 0.5)
        return found

    @cached_property
    def touched(self) -> Floats:
        """All contact points (k, 3) [m]."""
        return np.concatenate([*(p.points for p in self.recorded.contact_arrows if p.touches), np.empty((0, 3))])

    def drawn_now(self) -> Shown:
        """The same with every array computed, so that the thread that simulates does it and not the one that draws."""
        for name in ("tracks", "lines", "origins", "paths", "touched"):
            getattr(self, name)
        return self
