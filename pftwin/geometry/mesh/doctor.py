"""Mesh diagnosis: finds and describes faults, and makes the repairs that do not change the surface.

A finding has one of three severities: `safe` (can be repaired without changing the surface), `left` (only reported,
because a repair would add or remove surface) and `fatal` (contact cannot be computed: the outside is ambiguous, or the
mesh is not a surface there). An open surface is not in itself a fault.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.geometry.mesh.files import read_triangles
from pftwin.geometry.mesh.findings import (
    MeshFinding,
    crowded_edges,
    holes,
    isolated_parts,
    scale,
    superfluous_triangles,
    wrongly_turned,
)
from pftwin.geometry.mesh.mesh import (
    PLAUSIBLE,
    UNITS,
    SurfaceMesh,
    check_mesh,
    check_size,
    check_units,
    compacted,
    plausible_units,
    weld,
)
from pftwin.geometry.mesh.topology import MeshPart, parts_of, repeated, turned_over, zero_area


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Properties and findings of a mesh; coordinates and lengths are in the mesh's own unit."""

    source: str
    n_vertices: int  # after welding
    n_faces: int  # as in the file
    longest_side: float
    units: list[str]  # units in which the size is plausible for a part of the knee, most likely first
    parts: list[MeshPart]
    findings: list[MeshFinding]
    turn: NDArray[np.bool_]  # (m,) faces whose orientation a safe repair reverses
    drop: NDArray[np.bool_]  # (m,) faces that a safe repair removes

    def of(self, severity: str) -> list[MeshFinding]:
        """Findings of one severity: "safe", "left" or "fatal"."""
        return [f for f in self.findings if f.severity == severity]

    @property
    def verdict(self) -> str:
        """Summary in one sentence: usable, to be repaired, or not usable, with the kinds of findings."""
        if fatal := self.of("fatal"):
            return f"not to be used: {', '.join(f.kind for f in fatal)}"
        if safe := self.of("safe"):
            return f"to be repaired: {', '.join(f.kind for f in safe)} (--repair does it)"
        return "usable"

    def facts(self) -> dict[str, Any]:
        """Properties, parts, findings and verdict as a dictionary that can be written as JSON."""
        parts = [
            {
                "triangles": len(p.faces),
                "area": p.area,
                "closed": not p.loops,
                "volume": None if p.loops else p.volume,
                "loops": [
                    {"edges": k.n_edges, "length": k.length, "center": k.center, "hole": k.is_hole} for k in p.loops
                ],
            }
            for p in self.parts
        ]
        return {
            "file": self.source,
            "vertices": self.n_vertices,
            "triangles": self.n_faces,
            "longest_side": self.longest_side,
            "likely_units": self.units,
            "parts": parts,
            "findings": [vars(f) for f in self.findings],
            "verdict": self.verdict,
        }


def examine_file(path: str | os.PathLike[str], *, units: str | None = None) -> Diagnosis:
    """Examines a mesh file; see `examine`.

    Raises:
        InputError: unknown units, or a file that cannot be read at all (see `files.read_triangles`).
    """
    if units is not None:
        check_units(units)
    return examine(*read_triangles(Path(path)), source=str(path), units=units)


def examine(vertices: ArrayLike, faces: ArrayLike, *, source: str = "mesh", units: str | None = None) -> Diagnosis:
    """Examines a mesh for faults.

    Args:
        vertices, faces: (n, 3) in any unit and (m, 3), not yet welded.
        source: name for messages.
        units: unit of the coordinates; None: unknown, the size must be plausible in some unit.
    """
    p, f = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    n, none = len(f), np.zeros(len(f), dtype=bool)
    corners = np.unique(f)
    bad = corners[~np.isfinite(p[corners]).all(axis=1)]
    if bad.size:
        words = f"{bad.size} vertices of triangles are not finite, the first is number {bad[0]}: export the mesh again"
        lost = MeshFinding("not_finite", "fatal", int(bad.size), words)
        return Diagnosis(source, len(p), n, float("nan"), [], [], [lost], none, none)
    points, joined = weld(p, f)
    flat = zero_area(points, joined)
    copies, opposed = repeated(joined, ~flat)
    drop = flat | copies
    used_faces = np.flatnonzero(~drop)
    findings = superfluous_triangles(points, joined, flat, copies, opposed)
    if not used_faces.size:
        nothing = MeshFinding("no_surface", "fatal", n, f"all {n} triangles have no area: export the mesh again")
        return Diagnosis(source, len(points), n, float(np.ptp(p, axis=0).max()), [], [], [nothing], none, drop)
    mesh = SurfaceMesh(points, joined[used_faces], source)
    parts = parts_of(mesh)
    turned, winding = wrongly_turned(mesh, parts)
    used = points[np.unique(mesh.faces)]
    longest = float(np.ptp(used, axis=0).max())
    likely = plausible_units(longest)
    findings += [
        *crowded_edges(mesh),
        *winding,
        *holes(mesh, parts),
        *isolated_parts(mesh, parts),
        *scale(longest, likely, units),
    ]
    turn = none.copy()
    turn[used_faces] = turned
    return Diagnosis(source, len(used), n, longest, likely, parts, findings, turn, drop)


def repaired(
    vertices: ArrayLike, faces: ArrayLike, *, source: str = "mesh", units: str | None = None
) -> tuple[SurfaceMesh, Diagnosis]:
    """Makes all safe repairs; returns the mesh, in its own unit, and the findings that remain.

    Holes, isolated parts and cavities are not changed.

    Raises:
        InputError: the mesh has fatal findings.
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


_DROPPED = "zero_area"  # removed without a message, since the surface stays the same


class CheckedMesh(NamedTuple):
    """A mesh and notes about its findings and repairs."""

    mesh: SurfaceMesh
    notes: list[str]


def checked_mesh(path: str | os.PathLike[str], *, units: str, repair: bool = False) -> CheckedMesh:
    """Reads and examines a mesh file; the returned mesh is in metres.

    Args:
        path: STL, OBJ or PLY file.
        units: of its coordinates.
        repair: make the safe repairs: reorient triangles and remove duplicates.

    Raises:
        InputError: a file that cannot be read; a size that is implausible in these units; fatal findings; without
            `repair`, also findings that a safe repair would remove.
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
    """Descriptions of findings, lengths in the file's own unit; without the size, which `check_size` checks."""
    said = [f for severity in severities for f in found.of(severity) if f.kind != "scale"]
    return [f"{found.source}: {f.words}" for f in said]
