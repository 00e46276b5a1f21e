"""Parts of figures that tests ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.text import Text


def clipped(figure: Figure) -> list[str]:
    """Texts that do not lie wholly in a figure, but for numbers of axes, which are hidden where they are outside."""
    from matplotlib.text import Text

    figure.draw_without_rendering()
    x, y = figure.bbox.size
    out = []
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        box = text.get_window_extent()
        if len(text.get_text()) > 8 and not (-1 <= box.x0 <= box.x1 <= x + 1 and -1 <= box.y0 <= box.y1 <= y + 1):
            out.append(text.get_text())
    return out


def footers(figure: Figure) -> list[Text]:
    """Text below everything else: how to read a figure, and where its data come from."""
    return [text for text in figure.texts if text.get_gid() == "footer"]
