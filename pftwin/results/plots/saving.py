"""Figures as files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.results.plots.style import DPI, house_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# No dates: the same figure gives the same file.
_METADATA: dict[str, dict[str, Any]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


def save_figure(
    figure: Figure, stem: str | os.PathLike[str], kinds: Sequence[str] = ("png", "svg")
) -> tuple[Path, ...]:
    """Writes STEM.png and STEM.svg, or other kinds, each whole or not at all.

    Args:
        figure: of this package, or any other of matplotlib's.
        stem: path without a suffix.
        kinds: of files: "png", "svg", "pdf".

    Raises:
        InputError: another kind.
        OutputError: the folder is missing or cannot be written to.
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
