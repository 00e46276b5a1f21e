"""The knee in three dimensions: a widget for notebooks, and a page of one file that opens offline.

    result.view()  # in a notebook
    pftwin.viewer.view({"before": before, "after": "after.nc"}, html="view.html")

Drawn by k3d (extra `viewer`); docs/figures.md says what is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from k3d.plot import Plot

    from pftwin.results.result import Result

    Source = Result | str | os.PathLike[str]

__all__ = ["view"]


def view(
    results: Source | Sequence[Source] | Sequence[tuple[str, Source]] | Mapping[str, Source],
    html: str | os.PathLike[str] | None = None,
    *,
    side_by_side: bool = False,
) -> Plot:
    """Results as a k3d plot: the widget of a notebook, with play, a time slider and views below it.

    Args:
        results: a result or a file of one; several are overlaid in colours; a mapping, or pairs, give
            them names.
        html: also a page, of this file name, that needs nothing else.
        side_by_side: several are beside each other instead, each with its own bones.

    Raises:
        MissingExtraError: the extra `viewer` is not installed.
        InputError: no result, a file that is none, or one without anything to draw.
        OutputError: the page cannot be written.
    """
    from pftwin.results.viewer.assembly import plot
    from pftwin.results.viewer.knee import k3d
    from pftwin.results.viewer.page import add_controls, write_page
    from pftwin.results.viewer.recorded import recorded

    k3d()
    made, control = plot(recorded(results), side_by_side=side_by_side)
    add_controls(made, control)
    if html is not None:
        write_page(made, html)
    return made
