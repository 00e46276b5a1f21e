"""Triangle meshes of articulating surfaces, open or closed: reading, checking, writing."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.geometry.mesh.files import check_format, read_triangles

# Length units of mesh files [m], most common first.
UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 25.4e-3, "um": 1e-6, "dm": 1e-1}
PLAUSIBLE = (0.02, 0.2)  # longest side of a femoral component or a button [m]
COINCIDENT = 1e-7  # vertices closer than this share of the mesh's size are merged


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """A triangle mesh; faces are counter-clockwise seen from outside the body."""

    vertices: NDArray[np.float64]  # (n, 3) [m]
    faces: NDArray[np.int64]  # (m, 3)
    source: str = "mesh"  # file name or description, for messages

    @cached_property
    def area_vectors(self) -> NDArray[np.float64]:
        """Outward normal times area of each triangle, (m, 3) [m^2]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return 0.5 * np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """Area of each triangle, (m,) [m^2]."""
        return np.linalg.norm(self.area_vectors, axis=1)

    @property
    def area(self) -> float:
        """Area of the whole surface [m^2]."""
        return float(self.face_areas.sum())

    @cached_property
    def vertex_areas(self) -> NDArray[np.float64]:
        """Area of each vertex: a third of that of the triangles around it, (n,) [m^2]."""
        areas = np.bincount(self.faces.ravel(), np.repeat(self.face_areas / 3, 3), minlength=len(self.vertices))
        return areas.astype(np.float64)

    @cached_property
    def vertex_normals(self) -> NDArray[np.float64]:
        """Unit outward vertex normals, area-weighted, (n, 3); zero at a vertex that no triangle uses."""
        total = summed_at(self.faces, np.repeat(self.area_vectors, 3, axis=0), len(self.vertices))
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.divide(total, length, out=np.zeros_like(total), where=length > 0)

    @cached_property
    def extent(self) -> float:
        """Longest side of the bounding box [m]."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge borders two triangles."""
        from pftwin.geometry.mesh.topology import edges_of

        return bool(np.all(edges_of(self.faces).count == 2))

    @property
    def volume(self) -> float:
        """Signed volume enclosed by a closed mesh [m^3]; negative if its normals point inward."""
        return float(np.einsum("ij,ij->", self.vertices[self.faces].mean(axis=1), self.area_vectors) / 3)

    def flipped(self) -> SurfaceMesh:
        """The same surface with reversed faces."""
        return SurfaceMesh(self.vertices, self.faces[:, ::-1].copy(), self.source)


def check_units(units: str) -> None:
    """Raises InputError for a length unit that is not in `UNITS`."""
    if units not in UNITS:
        raise InputError(f"unknown length unit {units!r}", where="units", expected=f"one of {', '.join(UNITS)}")


def summed_at(groups: NDArray[np.int64], values: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Sums vectors (k, 3) over n groups, (n, 3); `groups`, flattened, holds the group of each vector."""
    sums = [np.bincount(groups.ravel(), values[:, k], minlength=n).astype(np.float64) for k in range(3)]
    return np.stack(sums, axis=1)


def load_mesh(
    path: str | os.PathLike[str],
    *,
    units: str,
    size: tuple[float, float] | None = PLAUSIBLE,
    repair: bool = False,
) -> SurfaceMesh:
    """Reads an STL, OBJ or PLY file, merges coincident vertices, and checks that the result is a usable surface.

    Args:
        path: the file.
        units: unit of the file's coordinates ("m", "mm", ...), which these formats do not state.
        size: smallest and largest plausible longest side [m]; the default suits femoral components and buttons; None:
            no check.
        repair: reorient triangles so that neighbours agree and a closed mesh faces outward, instead of raising.

    Raises:
        InputError: missing, empty or unreadable file; no triangles; vertices that are not finite; a size that is
            implausible in these units; adjacent triangles oriented differently; a closed mesh that is inside out.
    """
    check_units(units)
    vertices, faces = read_triangles(Path(path))
    return check_mesh(vertices * UNITS[units], faces, source=str(path), size=size, repair=repair, units=units)


def check_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    source: str = "mesh",
    size: tuple[float, float] | None = PLAUSIBLE,
    repair: bool = False,
    units: str = "m",
) -> SurfaceMesh:
    """Merges and checks vertices (n, 3) [m] and faces (m, 3) like `load_mesh`."""
    p, f = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if p.ndim != 2 or p.shape[1:] != (3,) or f.ndim != 2 or f.shape[1:] != (3,) or not f.size:
        raise InputError(
            f"no triangles: {f.shape} faces on {p.shape} vertices", where=source, expected="(m, 3) on (n, 3)"
        )
    if f.min() < 0 or f.max() >= len(p):
        raise InputError(f"a face names vertex {f.max()}, but there are {len(p)}", where=source)
    bad = np.flatnonzero(~np.isfinite(p).all(axis=1))
    if bad.size:
        found = f"{bad.size} of {len(p)} vertices are not finite, the first is number {bad[0]}: {p[bad[0]]}"
        raise InputError(found, where=source, remedy="export the mesh again")
    mesh = _welded_and_cleaned(p, f, source)
    if size is not None:
        check_size(mesh.extent, mesh.source, size, units)
    from pftwin.geometry.mesh.topology import check_winding

    return check_winding(mesh, repair)


def save_mesh(mesh: SurfaceMesh, path: str | os.PathLike[str], *, units: str = "m") -> None:
    """Writes an STL, OBJ or PLY file in the given units, atomically.

    Raises:
        InputError: unknown units or file type.
        OutputError: the file cannot be written.
    """
    import trimesh

    target = Path(path)
    check_units(units)
    check_format(target)
    exported = trimesh.Trimesh(mesh.vertices / UNITS[units], mesh.faces, process=False)
    data = exported.export(file_type=target.suffix[1:].lower())
    with written_whole(target) as partial:
        partial.write_bytes(data.encode() if isinstance(data, str) else data)  # pyright: ignore[reportArgumentType]


def weld(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Merges coincident vertices (within `COINCIDENT` of the size); the number of faces does not change."""
    used = vertices[np.unique(faces)]
    grid = COINCIDENT * max(float(np.ptp(used, axis=0).max()), np.finfo(float).tiny)
    _, first, inverse = np.unique(np.round(vertices / grid), axis=0, return_index=True, return_inverse=True)
    return vertices[first], inverse.ravel()[faces]


def _welded_and_cleaned(vertices: NDArray[np.float64], faces: NDArray[np.int64], source: str) -> SurfaceMesh:
    """Merges coincident vertices and removes triangles without area and unused vertices."""
    points, joined = weld(vertices, faces)
    faces_left = joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)]
    mesh = SurfaceMesh(points, faces_left, source)
    faces_left = faces_left[mesh.face_areas > 0]
    if not faces_left.size:
        raise InputError(f"all {len(faces)} triangles have no area", where=source, remedy="export the mesh again")
    return compacted(SurfaceMesh(points, faces_left, source))


def compacted(mesh: SurfaceMesh) -> SurfaceMesh:
    """The mesh without vertices that no triangle uses."""
    index, renumbered = np.unique(mesh.faces, return_inverse=True)
    return SurfaceMesh(mesh.vertices[index], renumbered.reshape(-1, 3), mesh.source)


def plausible_units(longest_side: float, size: tuple[float, float] = PLAUSIBLE) -> list[str]:
    """Units in which a longest side (a number without unit) is plausible for a part of the knee, most likely first."""
    low, high = size
    return [name for name, unit in UNITS.items() if low <= longest_side * unit <= high]


def check_size(longest_side: float, source: str, size: tuple[float, float], units: str) -> None:
    """Raises InputError for a longest side [m] outside `size` [m]; the message names a unit that would be plausible."""
    low, high = size
    if low <= longest_side <= high:
        return
    raw = longest_side / UNITS[units]
    found = f"{longest_side * 1e3:.4g} mm" if units == "mm" else f"{raw:.4g} {units} = {longest_side * 1e3:.4g} mm"
    fitting = plausible_units(raw, size)
    raise InputError(
        f"a longest side of {found} is implausible",
        where=source,
        expected=f"between {low * 1e3:g} and {high * 1e3:g} mm",
        remedy=f"units={fitting[0]!r}" if fitting else "check the units, or pass size= for an unusual part",
    )
