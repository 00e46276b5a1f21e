"""3D view of the knee: a notebook widget, and a single-file HTML page that opens offline.

    result.view()  # in a notebook
    pftwin.viewer.view({"before": before, "after": "after.nc"}, html="view.html")

Uses k3d (extra `viewer`); docs/figures.md describes what is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from pftwin.base.errors import InputError

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
    hidden: Collection[str] = (),
) -> Plot:
    """Shows results as a k3d plot: a notebook widget with a play button, a time slider and camera views.

    Args:
        results: a result or result file, or several, which are overlaid in different colours; a mapping or
            pairs give them names.
        html: file name of a self-contained page to write as well.
        side_by_side: draw several results next to each other, each with its own bones, instead of overlaid.
        hidden: names of results that stay hidden until their box is checked.

    Raises:
        MissingExtraError: the extra `viewer` is not installed.
        InputError: no result, a file that is not a result, one without anything to draw, or an unknown hidden name.
        OutputError: the page cannot be written.
    """
    from pftwin.results.viewer.assembly import plot
    from pftwin.results.viewer.knee import k3d
    from pftwin.results.viewer.page import add_controls, write_page
    from pftwin.results.viewer.recorded import recorded

    k3d()
    found = recorded(results)
    names = [r.name for r in found]
    if unknown := sorted(set(hidden) - set(names)):
        raise InputError(f"no result {', '.join(unknown)}", where="hidden", expected=f"some of: {', '.join(names)}")
    made, control = plot(found, side_by_side=side_by_side, hidden=hidden)
    add_controls(made, control)
    if html is not None:
        write_page(made, html)
    return made
