"""Panels side by side in rows, axes that users give, and the legend that is common to all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.results.plots.style import PAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def panels_in_rows(count: int, columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """A page wide, with one horizontal axis for all, named under the lowest panel of each column.

    Args:
        count: of panels.
        columns: at most so many.
        height: of a row [in].
    """
    from matplotlib.figure import Figure

    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(PAGE, height * rows + 0.9))
    grid = list(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel())
    for i, ax in enumerate(grid):
        lowest = i + columns >= count
        ax.tick_params(labelbottom=lowest)
        ax.xaxis.label.set_visible(lowest)
        if i >= count:
            ax.remove()
    return figure, grid[:count]


def given_axes(axes: Any, count: int, what: str) -> list[Any] | None:
    """A user's axes as a list; None where there are none.

    Raises:
        InputError: another number than there are panels.
    """
    if axes is None:
        return None
    found = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(found) != count:
        raise InputError(f"{len(found)} axes", where="axes", expected=f"{count}: {what}")
    return found


def figure_of(ax: Any) -> Figure:
    """The whole figure that axes are in, be it by way of a subfigure."""
    return ax.figure.figure


def entries(panels: Sequence[Axes]) -> tuple[list[Any], list[str]]:
    """Of the legends of all panels together: one may lack what others have."""
    found = {label: handle for ax in panels for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    return list(found.values()), list(found)
