"""Parts of figures that tests ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.text import Text


def footers(figure: Figure) -> list[Text]:
    """Text below everything else: how to read a figure, and where its data come from."""
    return [text for text in figure.texts if text.get_gid() == "footer"]
