"""A motion as what is drawn of it: poses of bodies, tubes, arrows and points at every frame. Femur frame, mm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pftwin.results.viewer.knee import FEW, REST, held, line_ends
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM, Matrices, Shape, apart, at_points, of_arrows, path, tubes

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ShownTrack:
    """Where something is, how it is turned, how large it is, and whether it is there, at every frame (n)."""

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
    """One motion."""

    recorded: Recorded
    newtons: float  # drawn as 10 mm of an arrow

    @cached_property
    def patella(self) -> ShownTrack:
        """The patella in the femur."""
        return ShownTrack.of(self.recorded.patella)

    @cached_property
    def tibia(self) -> ShownTrack:
        """The tibia in the femur."""
        return ShownTrack.of(self.recorded.tibia)

    @cached_property
    def lines(self) -> dict[str, tuple[NDArray[np.float32], NDArray[np.uint32]]]:
        """Tendons, ligaments and muscles as tubes: vertices (n, v, 3) and triangles, by name."""
        found = {}
        for name, lines in self.recorded.lines.items():
            ends = line_ends(self.recorded, lines)
            found[name] = tubes(ends, *((1.7, 10) if ends.shape[1] <= 2 * FEW else (0.55, 5)))
        return found

    @cached_property
    def origins(self) -> dict[str, Floats]:
        """Where lines begin on the tibia: their middle, tibia frame (3,) [mm]."""
        on_tibia = {n: lines for n, lines in self.recorded.lines.items() if lines.body == "tibia"}
        return {n: MM * lines.origin.reshape(-1, 3).mean(axis=0) for n, lines in on_tibia.items()}

    @cached_property
    def points(self) -> dict[str, ShownTrack]:
        """Contact points, by the facets' names."""
        pushes = [p for p in self.recorded.pushes if p.touches and p.present.any()]
        return {p.name: ShownTrack.of(at_points(held(p.points, p.present)), p.present) for p in pushes}

    @cached_property
    def arrows(self) -> dict[str, ShownTrack]:
        """Contact forces on the patella, for an arrow of length 1 along z."""
        found = {}
        for push in self.recorded.pushes:
            if push.forces is not None and push.present.any():
                here = push.present
                along = held(push.forces, here) * (10 / self.newtons)
                found[push.name] = ShownTrack.of(of_arrows(held(push.points, here), along), here)
        return found

    @cached_property
    def paths(self) -> dict[str, Shape]:
        """The way of each contact point."""
        found = {}
        for push in self.recorded.pushes:
            points = MM * np.where(push.present[:, None], push.points, np.nan)
            taken = apart(points, REST)
            if push.touches and taken.sum() > 1:
                found[push.name] = path(points[taken | ~push.present], 0.5)
        return found

    @cached_property
    def touched(self) -> Floats:
        """All contact points (k, 3) [m]."""
        return np.concatenate([*(p.points for p in self.recorded.pushes if p.touches), np.empty((0, 3))])

    def drawn_now(self) -> Shown:
        """The same, with all of the above computed: by the thread that simulates, not by the one that draws."""
        parts = (self.patella, self.tibia, self.lines, self.origins, self.points, self.arrows, self.paths, self.touched)
        assert len(parts) == 8
        return self
