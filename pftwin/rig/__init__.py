"""Knees in the box: a virtual test rig, the embedded default, with synthetic measurements; and a natural knee.

The rig reproduces that of Michaud et al. 2024 as far as it is published. Its measurements are synthetic: produced by a
plant that differs from the twin and shares none of its code (`pftwin.rig.plant`), written as a laboratory's files, read
back like a user's. The natural knee (`knee`) is made of anatomical numbers; its motions and loads are made up.
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
