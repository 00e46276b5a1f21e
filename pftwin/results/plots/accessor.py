"""`result.plot`: the figures of a simulation."""

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
    """Each method gives a matplotlib figure; `figure.savefig("name.pdf")` writes it, as do .svg and .png."""

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
        """Tilt, shift, rotation and contact force against knee flexion: mean and one standard deviation over strokes.

        Args:
            others: variants that belong to the same mean.
            measured, show, strokes, title, axes: as in `pftwin.results.plots.against_flexion`, which also draws
                several groups.

        Raises:
            InputError: a knee that does not bend, and what else `pftwin.results.plots.against_flexion` refuses.
        """
        everything = [self._result, *others]
        return against_flexion(everything, measured=measured, show=show, strokes=strokes, title=title, axes=axes)

    def trajectory(
        self, *, measured: Measured | None = None, title: str | None = None, ax: Axes | None = None
    ) -> Figure:
        """The button's path and the contact path of each facet over the trochlea's contours.

        Args:
            measured, title, ax: as in `pftwin.results.plots.trajectory`.

        Raises:
            InputError: a scene without contact.
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
        """Everything that was measured beside what was simulated, with root mean square errors.

        Args:
            measured, against, tibial, femoral, title, axes: as in `pftwin.results.plots.compared`, which also draws
                several.

        Raises:
            InputError: no measurements, or not of this motion.
        """
        return compared(self._result, measured, against=against, tibial=tibial, femoral=femoral, title=title, axes=axes)
