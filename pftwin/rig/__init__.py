"""Built-in knees: a virtual test rig with synthetic measurements (the default) and a natural knee.

The rig reproduces that of Michaud et al. 2024 as far as it is published. Its measurements are synthetic: a plant that
differs from the twin and has its own code (`pftwin.rig.plant`) produces them, and they are written and read as
laboratory files. The natural knee (`knee`) is built from anatomical parameters; its motions and loads are invented.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin.geometry.bones.anatomy import Anatomy
    from pftwin.geometry.bones.surfaces import bones
    from pftwin.rig.cases import case, measured, write_files
    from pftwin.rig.natural.scene import knee
    from pftwin.rig.retinacula import with_retinacula

__all__ = ["Anatomy", "bones", "case", "knee", "measured", "with_retinacula", "write_files"]

_PLACES = {
    "Anatomy": "geometry.bones.anatomy",
    "bones": "geometry.bones.surfaces",
    "knee": "rig.natural.scene",
    "with_retinacula": "rig.retinacula",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'pftwin.rig' has no attribute {name!r}")
    return getattr(import_module(f"pftwin.{_PLACES.get(name, 'rig.cases')}"), name)
