"""Built-in knees: a virtual test rig with synthetic measurements (the default) and a natural knee.

The rig reproduces that of Michaud et al. 2024 as far as it is published. Its measurements are synthetic: recordings of
a plant that differs from the twin and has its own code (`tests/verification/rig_plant`), read as laboratory files. The
natural knee (`knee`) is built from anatomical parameters; its motions and loads are invented.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pftwin.base.lazy_names import lazy_names

if TYPE_CHECKING:  # `as` marks names that are exported
    from pftwin.geometry.bones.anatomy import Anatomy as Anatomy
    from pftwin.geometry.bones.surfaces import bones as bones
    from pftwin.rig.cases import case as case
    from pftwin.rig.cases import measured as measured
    from pftwin.rig.cases import write_files as write_files
    from pftwin.rig.natural.scene import knee as knee
    from pftwin.rig.retinacula import with_retinacula as with_retinacula

_HOMES = {
    "pftwin.geometry.bones.anatomy": ("Anatomy",),
    "pftwin.geometry.bones.surfaces": ("bones",),
    "pftwin.rig.cases": ("case", "measured", "write_files"),
    "pftwin.rig.natural.scene": ("knee",),
    "pftwin.rig.retinacula": ("with_retinacula",),
}

if not TYPE_CHECKING:  # so that type checkers report names that do not exist
    __getattr__, __dir__, __all__ = lazy_names("pftwin.rig", _HOMES)
