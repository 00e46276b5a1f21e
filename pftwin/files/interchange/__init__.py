"""Exchange with other programs: exports results as .mot, .sto, .glb and .csv; imports OpenSim models as scene folders.

pftwin.interchange.export("case2.nc", "case2.glb")  # or a `Result`
pftwin.interchange.import_osim("knee.osim", "knee")  # writes knee/scene.toml and a list of what was not imported
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin.files.interchange.exporting import export
    from pftwin.files.interchange.osim_scene import import_osim

_HOME = {"export": "exporting", "import_osim": "osim_scene"}

__all__ = ["export", "import_osim"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'pftwin.files.interchange' has no attribute {name!r}")
    return getattr(import_module(f"pftwin.files.interchange.{_HOME[name]}"), name)
