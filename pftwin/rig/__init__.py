"""The virtual test rig, the embedded default: four cases, and synthetic measurements of them.

The rig reproduces that of Michaud et al. 2024 as far as it is published. Its measurements are synthetic: produced by a
plant that differs from the twin and shares none of its code (`pftwin.rig.plant`), written as a laboratory's files, read
back like a user's.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin.rig.cases import case, measured, write_files
    from pftwin.rig.retinacula import with_retinacula

__all__ = ["case", "measured", "with_retinacula", "write_files"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'pftwin.rig' has no attribute {name!r}")
    return getattr(import_module(f"pftwin.rig.{'retinacula' if name == 'with_retinacula' else 'cases'}"), name)
