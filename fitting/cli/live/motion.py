"""A simulated motion as the live page shows it: time series, texts and arrays for the drawing (femur frame, mm)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fitting.prediction.predicted_motion import LEVEL
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.results.verdict import Verdict
from pftwin.results.viewer.knee import REST, gaps_filled
from pftwin.results.viewer.recorded import Recorded
from pftwin.results.viewer.shapes import MM, Matrices, Shape, at_points, line_shape, of_arrows, path, spaced_points

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

UNTREATED, AS_SET = "untreated", "as set"  # names of motions: as the sliders are set, which may be at rest
_REMEDY = "other values"


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """Time series and results of one motion; series are at the displayed frames (n,)."""

    result: Result
    recorded: Recorded
    dislocates: bool | None  # None: without a groove, or if the motion is INVALID
    finite: bool
    settled: bool  # whether it starts from an equilibrium
    flexion: Floats  # of the knee [deg]
    out: NDArray[np.bool_]  # whether the patella is out of its groove
    tilt: Floats  # [deg]
    shift: Floats  # [mm]
    force: Floats  # of the contact [N]; NaN without one
    highest_force: float  # over all frames [N]
    continued: Callable[[Floats], Shape | None]  # extrapolated surface as far as contact points (k, 3) [m] reach
    seconds: float = 0.0  # computing time

    @classmethod
    def of(
        cls,
        result: Result,
        name: str,
        geometry: Dataset,
        continued: Callable[[Floats], Shape | None],
        start: tuple[str, ...],
    ) -> ShownMotion:
        """From a result, a name for the legend, the geometry of its scene, a function for `continued`, and reasons why
        the untreated scene's start makes it INVALID."""
        from pftwin.dynamics.status import Status

        verdict = Verdict(tuple(dict.fromkeys((*result.verdict.reasons, *start))))
        outcome = result.dislocations() if verdict.valid else None
        recorded = replace(Recorded.of(result, name, geometry=geometry), verdict=verdict)
        force = None if result.contact is None else recorded.series(f"{result.contact}_force")
        every = np.array([np.nan]) if force is None else np.asarray(result.effects[str(result.contact)]["force"])
        there = every[np.isfinite(every)]
        out = np.zeros(result.times.size, dtype=bool) if outcome is None else outcome.dislocated
        tilt, shift = recorded.series("patella_tilt"), recorded.series("patella_shift")
        assert tilt is not None
        assert shift is not None
        return cls(
            result,
            recorded,
            None if outcome is None else bool(outcome.events),
            not (result.flags & int(Status.NOT_FINITE)).any(),
            bool(result.equilibrium.converged),
            np.degrees(np.asarray(result.knee.flexion, dtype=np.float64))[recorded.frames],
            out[recorded.frames],
            tilt,
            1e3 * shift,
            np.full_like(tilt, np.nan) if force is None else force,
            float(there.max()) if there.size else float("nan"),
            continued,
        )

    @property
    def times(self) -> Floats:
        """Times of the displayed frames (n,) [s]."""
        return self.recorded.times

    def named(self, name: str) -> ShownMotion:
        """The same motion under another name."""
        return replace(self, recorded=replace(self.recorded, name=name))

    def refuse_if_lost(self, unlike: ShownMotion | None = None) -> None:
        """Raises InputError for non-finite frames, and for a start without equilibrium if that of `unlike` has one."""
        if not self.finite:
            raise InputError("the patella is lost in this motion (frames are not finite)", remedy=_REMEDY)
        if not self.settled and unlike is not None and unlike.settled:
            raise InputError("there is no static equilibrium to start from", remedy=_REMEDY)


class Band(NamedTuple):
    """Range of the middle 90 % of draws from an estimate, at the displayed frames."""

    ends: dict[str, tuple[Floats, Floats]]  # low and high, (n,) each, by the curve's name in `ShownMotion`
    words: str

    @classmethod
    def of(cls, results: Sequence[Result], answer: ShownMotion, draws: int) -> Band:
        """Computes the band from the valid motions of `draws` draws; `answer` is the estimate's own motion."""
        contact, rows = answer.result.contact, []
        for result in results:
            force = np.full(result.times.size, np.nan) if contact is None else result.effects[contact]["force"]
            rows.append((np.degrees(result.angles.tilt), 1e3 * result.shift, force))
        low, high = np.quantile(rows, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL], axis=0)[..., answer.recorded.frames]
        lost = draws - len(results)
        left_out = f"; {lost} without a valid motion were omitted" if lost else ""
        out = sum(bool(found.events) for r in results if (found := r.dislocations()) is not None)
        words = f"Bands: the middle {100 * LEVEL:.0f} % of {draws} draws from the estimate{left_out}. {out} dislocate."
        return cls({name: (low[k], high[k]) for k, name in enumerate(("tilt", "shift", "force"))}, words)


@dataclass(frozen=True, eq=False)
class DrawnTrack:
    """Position, rotation, scale and presence of a drawn part at every frame (n)."""

    position: Floats  # (n, 3) [mm]
    wxyz: Floats  # (n, 4)
    scale: Floats  # (n,)
    present: NDArray[np.bool_]  # (n,)

    @classmethod
    def of(cls, matrices: Matrices, present: NDArray[np.bool_] | None = None) -> DrawnTrack:
        """From model matrices (n, 4, 4) with uniform scale."""
        from scipy.spatial.transform import Rotation

        turn = matrices[:, :3, :3].astype(np.float64)
        scale = np.linalg.norm(turn[:, :, 2], axis=1)
        wxyz = Rotation.from_matrix(turn / scale[:, None, None]).as_quat(scalar_first=True)
        there = np.ones(len(matrices), dtype=bool) if present is None else present
        return cls(matrices[:, :3, 3].astype(np.float64), wxyz, scale, there)


class DrawnMotion:
    """The drawing of one motion.

    Attributes:
        tracks: of "patella" and "tibia"; of each facet's contact point, "at FACET", and force, "on FACET": an arrow of
            length 1 along z.
        paths: of each contact point, "way FACET".
        lines: tendons, ligaments and muscles, as tubes or ribbons: vertices (n, v, 3) and triangles, by name.
        origins: mean origin on the tibia of each effect's lines, tibia frame (3,) [mm].
        touched: all contact points (k, 3) [m].
    """

    def __init__(self, recorded: Recorded, newtons: float) -> None:
        """Draws a motion; an arrow of 10 mm stands for a force of `newtons`."""
        self.recorded = recorded
        self.tracks = {"patella": DrawnTrack.of(recorded.patella), "tibia": DrawnTrack.of(recorded.tibia)}
        self.paths: dict[str, Shape] = {}
        for arrow in recorded.contact_arrows:
            here = arrow.present
            if not here.any():
                continue
            points = gaps_filled(arrow.points, here)
            if arrow.touches:
                self.tracks[f"at {arrow.name}"] = DrawnTrack.of(at_points(points), here)
                way = MM * np.where(here[:, None], arrow.points, np.nan)
                if (taken := spaced_points(way, REST)).sum() > 1:
                    self.paths[f"way {arrow.name}"] = path(way[taken | ~here], 0.5)
            if arrow.forces is not None:
                along = gaps_filled(arrow.forces, here) * (10 / newtons)
                self.tracks[f"on {arrow.name}"] = DrawnTrack.of(of_arrows(points, along), here)
        self.lines = {name: line_shape(lines.paths, lines.radius) for name, lines in recorded.lines.items()}
        schematic = recorded.mesh("tibia_bone") is None
        on_tibia = {n: lines for n, lines in recorded.lines.items() if lines.body == "tibia" and schematic}
        self.origins = {n: MM * lines.origin.reshape(-1, 3).mean(axis=0) for n, lines in on_tibia.items()}
        touching = [p.points for p in recorded.contact_arrows if p.touches]
        self.touched = np.concatenate([*touching, np.empty((0, 3))])
