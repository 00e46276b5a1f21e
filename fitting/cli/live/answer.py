"""A simulated motion as the page needs it: what to draw, its numbers, and what is to be said of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.results.viewer.recorded import Recorded

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

_REMEDY = "other values"


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """One motion; series are at the frames that are shown (n,)."""

    recorded: Recorded
    dislocates: bool | None  # None: there is no groove to leave
    tracking: str  # in words, with times
    status: str  # how far to trust it, in words
    finite: bool
    settled: bool  # whether it starts from an equilibrium
    tilt: NDArray[np.float64]  # [deg]
    shift: NDArray[np.float64]  # [mm]
    force: NDArray[np.float64]  # of the contact [N]; NaN without one
    highest_force: float  # over all frames [N]
    seconds: float = 0.0  # from the treated scene to here

    @classmethod
    def of(cls, result: Result, name: str, geometry: Dataset) -> ShownMotion:
        """From a result.

        Args:
            result: of the simulation.
            name: in the legend.
            geometry: what there is to draw of its scene.

        Raises:
            InputError: fewer than two frames of it are finite.
        """
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
            "there is no groove to leave" if outcome is None else outcome.describe(),
            result.status.describe(),
            not (result.flags & int(Status.NOT_FINITE)).any(),
            bool(result.equilibrium.converged),
            tilt,
            1e3 * shift,
            np.full_like(tilt, np.nan) if force is None else force,
            float(there.max()) if there.size else float("nan"),
        )

    @property
    def times(self) -> NDArray[np.float64]:
        """Of the frames that are shown (n,) [s]."""
        return self.recorded.times

    def named(self, name: str) -> ShownMotion:
        """The same under another name."""
        return replace(self, recorded=replace(self.recorded, name=name))

    def refuse_if_lost(self, unlike: ShownMotion | None = None) -> None:
        """Refuses a motion that means nothing.

        Args:
            unlike: the untreated one; what that lacks too is no reason.

        Raises:
            InputError: frames that are not finite; no equilibrium to start from.
        """
        if not self.finite:
            raise InputError("the patella is lost in this motion (frames are not finite)", remedy=_REMEDY)
        if not self.settled and unlike is not None and unlike.settled:
            raise InputError("there is no static equilibrium to start from", remedy=_REMEDY)
