"""Style of figures (colours, dashes, markers, sizes), layout of panels and legends, and export to files.

The style applies only inside `with house_style():`; matplotlib's global settings do not change.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.base.text_files import shortened_list

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pftwin.results.result import Result

# Without dates, the same figure gives the same file.
_METADATA: dict[str, dict[str, Any]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
# Palette of Okabe and Ito 2008 without yellow, which is faint on white; measurements are black.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
# Lines also differ by dashes or markers, for greyscale prints and readers who see no colour.
DASHES: tuple[Any, ...] = (
    "-", (0, (6, 1.5)), (0, (3, 1.2)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip
MARKERS = "osD^vP*X"
TEXT, SMALL, TINY = 9.0, 8.0, 7.0  # font sizes [pt]: normal text, panel legends, notes and footers
COLUMN, PAGE, WIDE = 3.5, 7.2, 11.0  # widths of figures [in]: a journal's column, its page, a screen
DPI = 160  # of PNG files
FAINT = "0.35"  # grey of footers
_SPACING, _MARGIN = 1.25, 3.0  # line spacing of a footer relative to its font size; margin around it [pt]
STYLE: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so figures look the same on every machine
    "font.size": TEXT,
    "axes.titlesize": TEXT,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "text.parse_math": False,  # otherwise a name with two "$" is typeset as a formula or fails
    "svg.fonttype": "none",  # text stays text: searchable, and editable in a drawing program
    "svg.hashsalt": "pftwin",
    "pdf.fonttype": 42,
}
MEASURED: dict[str, Any] = {"color": "black", "linewidth": 2.6, "alpha": 0.35, "zorder": 1}
BAND: dict[str, Any] = {"alpha": 0.2, "linewidth": 0}
START: dict[str, Any] = {"marker": "o", "markersize": 4, "linestyle": "none"}


def save_figure(
    figure: Figure, stem: str | os.PathLike[str], kinds: Sequence[str] = ("png", "svg")
) -> tuple[Path, ...]:
    """Writes STEM.png and STEM.svg, or other kinds of file, each atomically.

    Args:
        figure: any matplotlib figure.
        stem: path without a suffix.
        kinds: file types: "png", "svg", "pdf".

    Raises:
        InputError: an unknown file type.
        OutputError: the folder is missing or not writable.
    """
    base = Path(stem)
    for kind in kinds:
        if kind not in _METADATA:
            raise InputError(f"unknown kind of figure {kind!r}", where="kinds", expected=", ".join(_METADATA))
    paths = tuple(base.with_name(f"{base.name}.{kind}") for kind in kinds)
    with house_style():
        for path, kind in zip(paths, kinds, strict=True):
            with written_whole(path) as temporary:
                figure.savefig(temporary, dpi=DPI, metadata=_METADATA[kind])
    return paths


def panels_in_rows(count: int, columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """Creates a figure with `count` panels in at most `columns` columns and rows of `height` [in].

    It is one page wide, or with one column a journal's column. The panels share the horizontal axis, which is labelled
    under the lowest panel of each column.
    """
    from matplotlib.figure import Figure

    width = COLUMN if columns == 1 else PAGE
    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(width, height * rows + 0.9))
    grid = list(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel())
    for i, ax in enumerate(grid):
        lowest = i + columns >= count
        ax.tick_params(labelbottom=lowest)
        ax.xaxis.label.set_visible(lowest)
        if i >= count:
            ax.remove()
    return figure, grid[:count]


def given_axes(axes: Any, count: int, what: str) -> list[Any] | None:
    """Returns a user's axes as a list, or None if none are given; InputError if their number is not `count`."""
    if axes is None:
        return None
    found = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(found) != count:
        raise InputError(f"{len(found)} axes", where="axes", expected=f"{count}: {what}")
    return found


def figure_of(ax: Any) -> Figure:
    """Returns the top-level figure that contains the axes, also for axes in a subfigure."""
    return ax.figure.figure


def legend_entries(panels: Sequence[Axes]) -> tuple[list[Any], list[str]]:
    """Returns the combined legend handles and labels of all panels, without duplicates."""
    found = {label: handle for ax in panels for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    return list(found.values()), list(found)


def house_style(**changes: Any) -> AbstractContextManager[None]:
    """Returns the context in which figures are made and saved; names in `changes` have "__" in place of a dot."""
    import matplotlib as mpl

    settings: Any = {**STYLE, **{name.replace("__", "."): value for name, value in changes.items()}}
    return mpl.rc_context(settings)


def line(i: int) -> dict[str, Any]:
    """Returns the colour and dashes of the i-th line."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}


def shortened(name: str, most: int = 30) -> str:
    """Returns a name with at most `most` characters: of a longer one its beginning and end, since names differ there.

    For labels beside panels, which would leave no room to the panels if they were long.
    """
    half = (most - 1) // 2
    return name if len(name) <= most else f"{name[: most - 1 - half]}\N{HORIZONTAL ELLIPSIS}{name[len(name) - half :]}"


def title(figure: Any, *lines: str | None) -> None:
    """Sets the figure's title, wrapped to its width; lines that are None are skipped."""
    for size in (TEXT, 1.25 * TEXT, 2 * TEXT):  # as if the letters were larger, if they are wide ones
        text = figure.suptitle("\n".join(_wrapped(figure, lines, size)), fontsize=TEXT)
        if text.get_window_extent().width <= figure.bbox.width:
            return


def scene_names(results: Iterable[Result]) -> str:
    """Returns the names of the results' scenes for a title, each once."""
    return shortened_list(dict.fromkeys(shortened(r.scene_name, 80) for r in results), 4, "; ")


def footer(figure: Any, *lines: str | None) -> None:
    """Adds small notes at the bottom of the figure: how to read it and where its data come from.

    Call it before `legend_below`, which places the legend above it. Lines that are None are skipped.
    """
    wrapped = _wrapped(figure, lines, TINY)
    if not wrapped:
        return
    height = (TINY * _SPACING * len(wrapped) + _MARGIN) / (72 * figure.get_figheight())
    left, bottom = (_MARGIN / (72 * size) for size in (figure.get_figwidth(), figure.get_figheight()))
    look: dict[str, Any] = {"fontsize": TINY, "color": FAINT, "linespacing": _SPACING, "va": "bottom"}
    figure.text(left, bottom, "\n".join(wrapped), gid="footer", **look)
    figure.get_layout_engine().set(rect=(0, height, 1, 1 - height))


def _wrapped(figure: Any, lines: Sequence[str | None], size: float) -> list[str]:
    """Wraps lines to the figure's width at a font size [pt]; a letter is about 0.56 of that size wide."""
    characters = int(figure.get_figwidth() * 72 / (0.56 * size))
    return [part for line in lines if line for part in textwrap.wrap(line, characters)]


def legend_below(figure: Any, handles: list[Any], labels: list[str], most: int = 4) -> None:
    """Adds a legend below all panels and above the footer, in at most `most` columns, fewer in a narrow figure."""
    if not labels:
        return
    above_footer = 72 * figure.get_figheight() * figure.get_layout_engine().get()["rect"][1]
    for columns in range(min(most, len(labels)), 0, -1):
        legend = figure.legend(
            handles, labels, loc="outside lower center", ncols=columns, fontsize=SMALL,
            borderaxespad=(above_footer + _MARGIN) / SMALL,
        )  # fmt: skip
        if legend.get_window_extent().width <= figure.bbox.width:
            return
        if columns > 1:
            legend.remove()
    most = max(map(len, labels))
    while legend.get_window_extent().width > figure.bbox.width and most > 10:
        most = int(0.9 * most)
        for text, label in zip(legend.get_texts(), labels, strict=True):
            text.set_text(shortened(label, most))


def legend_above(axes: Any, title: str | None = None, **more: Any) -> None:
    """Adds a legend on top of a panel, below the panel's title."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, borderpad=0.0, fontsize=SMALL,
        handlelength=1.8, title=title, title_fontsize=TEXT, alignment="left", **more,
    )  # fmt: skip
