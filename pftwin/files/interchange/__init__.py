"""Exchange with other programs: exports results as .mot, .sto, .glb and .csv; imports OpenSim models as scene folders.

pftwin.interchange.export("case2.nc", "case2.glb")  # or a `Result`
pftwin.interchange.import_osim("knee.osim", "knee")  # writes knee/scene.toml and a list of what was not imported
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pftwin.base.lazy_names import lazy_names

if TYPE_CHECKING:  # `as` marks names that are exported
    from pftwin.files.interchange.exporting import export as export
    from pftwin.files.interchange.osim_scene import import_osim as import_osim

_HERE = "pftwin.files.interchange"
_HOMES = {f"{_HERE}.exporting": ("export",), f"{_HERE}.osim_scene": ("import_osim",)}

if not TYPE_CHECKING:  # so that type checkers report names that do not exist
    __getattr__, __dir__, __all__ = lazy_names("pftwin.interchange", _HOMES)
