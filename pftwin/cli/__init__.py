"""The command line. Commands import their dependencies when they run, so that `pftwin --help` is fast.

The program is created on first access, because it includes commands of other packages, which import from this one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin.cli.program import app, main

__all__ = ["app", "main"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'pftwin.cli' has no attribute {name!r}")
    from pftwin.cli import program

    return getattr(program, name)
