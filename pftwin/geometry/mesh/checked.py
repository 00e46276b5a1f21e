"""Mesh files for contact: what no contact can be computed with is refused, what is merely odd is said."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.doctor import Diagnosis, examine
from pftwin.geometry.mesh.files import read_triangles
from pftwin.geometry.mesh.mesh import SurfaceMesh, check_mesh
from pftwin.geometry.mesh.repair import repaired
from pftwin.geometry.mesh.units import PLAUSIBLE, UNITS, check_size

_DROPPED = "zero_area"  # left out without asking: the surface is the same


class CheckedMesh(NamedTuple):
    """A mesh and what is to be said about it."""

    mesh: SurfaceMesh
    notes: list[str]


def checked_mesh(path: str | os.PathLike[str], *, units: str, repair: bool = False) -> CheckedMesh:
    """Read a mesh file, have the mesh doctor look it over, and give the mesh in metres.

    Args:
        path: STL, OBJ or PLY.
        units: of its coordinates.
        repair: turn triangles and drop doubles where that leaves the surface what it is.

    Raises:
        InputError: a file that cannot be read; a size that does not suit the units; findings of the doctor's that no
            contact can be computed with, and without `repair` those that a repair would remove.
    """
    vertices, faces = read_triangles(Path(path))
    points, source = vertices * UNITS[units], str(path)
    found = examine(vertices, faces, source=source)
    _refuse(found, "fatal", "pftwin doctor-mesh says where; a mesh editor")
    check_size(found.longest_side * UNITS[units], source, PLAUSIBLE, units)
    if not repair:
        _refuse(found, "safe", "repair = true, or pftwin doctor-mesh --repair and the mesh that it writes")
        mesh = check_mesh(points, faces, source=source, units=units)
        return CheckedMesh(mesh, _notes(found, ("left", "safe")))
    mesh, after = repaired(vertices, faces, source=source)
    mesh = SurfaceMesh(mesh.vertices * UNITS[units], mesh.faces, source)
    repairs = [f"{source}: repaired: {f.words}" for f in found.of("safe")]
    return CheckedMesh(mesh, repairs + _notes(after, ("left",)))


def _refuse(found: Diagnosis, severity: str, remedy: str) -> None:
    wrong = [f for f in found.of(severity) if f.kind != _DROPPED]
    if wrong:
        words = "; ".join(f"{f.kind.replace('_', ' ')}: {f.words}" for f in wrong)
        raise InputError(words, where=found.source, remedy=remedy)


def _notes(found: Diagnosis, severities: tuple[str, ...]) -> list[str]:
    """The rest of what the doctor says, lengths in the file's own unit; sizes have been looked at."""
    said = [f for severity in severities for f in found.of(severity) if f.kind != "scale"]
    return [f"{found.source}: {f.words}" for f in said]
