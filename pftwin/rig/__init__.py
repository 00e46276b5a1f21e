"""The virtual test rig, the embedded default: four cases, and synthetic measurements of them.

The rig reproduces that of Michaud et al. 2024 as far as it is published. Its measurements are synthetic: produced by a
plant that differs from the twin (`pftwin.rig.plant`), written as a laboratory's files, read back like a user's.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene

__all__ = ["case", "measured", "with_retinacula", "write_files"]


def case(n: int, contact: str = "P5", *, chart: Literal["plane", "cylinder"] = "plane") -> Scene:
    """One of the rig's four cases as a scene; see `pftwin.rig.cases.case`."""
    from pftwin.rig.cases import case as build

    return build(n, contact, chart=chart)


def with_retinacula(
    scene: Scene, ligaments: Sequence[str] = ("mpfl", "lpfl"), *, reference_strain: float = 0.0
) -> Scene:
    """A case with patellofemoral ligaments; see `pftwin.rig.retinacula.with_retinacula`."""
    from pftwin.rig.retinacula import with_retinacula as build

    return build(scene, ligaments, reference_strain=reference_strain)


def measured(n: int) -> Measured:
    """What the virtual laboratory measured of a case. Synthetic.

    Raises:
        InputError: no such case.
    """
    from pftwin.rig.cases import recording

    return recording(n).measured


def write_files(n: int, folder: Path) -> list[Path]:
    """Writes the laboratory's files of a case to a folder: markers, forces, and the implant's mesh.

    Raises:
        InputError: no such case.
        OutputError: a file cannot be written.
    """
    from pftwin.base.output import written_whole
    from pftwin.rig.cases import recording
    from pftwin.rig.recording import IMPLANT_FILE, data_folder

    recording(n)
    written = []
    for name in (f"case{n}_markers.trc", f"case{n}_forces.csv", IMPLANT_FILE):
        target = Path(folder) / name
        with written_whole(target) as path:
            path.write_bytes((data_folder() / name).read_bytes())
        written.append(target)
    return written
