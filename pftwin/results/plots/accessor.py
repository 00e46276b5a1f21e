"""The accessor `result.plot`, with one method for each figure of a simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pftwin.results.plots.against_flexion import SHOWN, Strokes, against_flexion
from pftwin.results.plots.compared import compared
from pftwin.results.plots.quantities import FEMORAL, TIBIAL
from pftwin.results.plots.trajectory import trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.model.measured import Measured
    from pftwin.results.result import Result


class ResultPlots:
    """Figures of a result. Each method returns a matplotlib figure; `figure.savefig("name.pdf")` writes it."""

    def __init__(self, result: Result) -> None:
        self._result = result

    def against_flexion(
        self,
        *others: Result,
        measured: Measured | None = None,
        show: tuple[str, ...] = SHOWN,
        strokes: Strokes = "apart",
        title: str | None = None,
        axes: Any = None,
    ) -> Figure:
        """Plots tilt, shift, rotation and contact force against knee flexion, mean and standard deviation over strokes.

        Args:
            others: variants to include in the same mean.
            measured, show, strokes, title, axes: as in `pftwin.results.plots.against_flexion`, which also draws
                several groups.

        Raises:
            InputError: the knee does not bend, or as in `pftwin.results.plots.against_flexion`.
        """
        everything = [self._result, *others]
        return against_flexion(everything, measured=measured, show=show, strokes=strokes, title=title, axes=axes)

    def trajectory(
        self, *, measured: Measured | None = None, title: str | None = None, ax: Axes | None = None
    ) -> Figure:
        """Plots the button's path and the contact path of each facet over a contour map of the trochlea.

        Args:
            measured, title, ax: as in `pftwin.results.plots.trajectory`.

        Raises:
            InputError: the scene has no contact.
        """
        return trajectory(self._result, measured=measured, title=title, ax=ax)

    def compared(
        self,
        measured: Measured | None,
        *,
        against: Literal["time", "flexion"] = "time",
        tibial: str | None = TIBIAL,
        femoral: str | None = FEMORAL,
        title: str | None = None,
        axes: Any = None,
    ) -> Figure:
        """Plots each measured quantity against the simulated one, with the root mean square error.

        Args:
            measured, against, tibial, femoral, title, axes: as in `pftwin.results.plots.compared`, which also draws
                several results.

        Raises:
            InputError: there are no measurements, or they are not of this motion.
        """
        return compared(self._result, measured, against=against, tibial=tibial, femoral=femoral, title=title, axes=axes)
