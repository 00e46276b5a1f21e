"""Repairs that leave the surface what it is: turned triangles, dropped duplicates and triangles without area."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.doctor import Diagnosis, examine
from pftwin.geometry.mesh.files import read_triangles
from pftwin.geometry.mesh.mesh import SurfaceMesh, compacted, weld
from pftwin.geometry.mesh.winding import turned_over


def repaired_file(path: str | os.PathLike[str], *, units: str | None = None) -> tuple[SurfaceMesh, Diagnosis]:
    """Repair the mesh of a file; see `repaired`."""
    return repaired(*read_triangles(Path(path)), source=str(path), units=units)


def repaired(
    vertices: ArrayLike, faces: ArrayLike, *, source: str = "mesh", units: str | None = None
) -> tuple[SurfaceMesh, Diagnosis]:
    """The mesh with all that is safe repaired, in the unit it came in, and what the doctor finds in it afterwards.

    Holes, isolated parts and cavities stay as they are.

    Raises:
        InputError: findings that no safe repair removes and that no contact can be computed with.
    """
    found = examine(vertices, faces, source=source, units=units)
    if fatal := found.of("fatal"):
        raise InputError(
            "; ".join(f"{f.kind}: {f.words}" for f in fatal),
            where=source,
            remedy="a mesh editor: a repair of this would change the answer",
        )
    points, joined = weld(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    turned = turned_over(joined, found.turn)[~found.drop]
    mesh = compacted(SurfaceMesh(points, turned, source))
    return mesh, examine(mesh.vertices, mesh.faces, source=source, units=units)
