"""Reads the triangles of STL, OBJ and PLY files with trimesh; rejects damaged and oversized files."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.base.text_files import MESH_BYTES, MESH_TRIANGLES

_FORMATS = (".stl", ".obj", ".ply")


def check_format(path: Path) -> None:
    """Raises InputError for a file type other than STL, OBJ and PLY."""
    if path.suffix.lower() not in _FORMATS:
        raise InputError(
            f"unknown mesh format {path.suffix or '(no extension)'}", where=path, expected=", ".join(_FORMATS)
        )


def read_triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Reads vertices (n, 3) in the file's own unit and faces (m, 3), without welding or cleaning.

    Raises InputError for a missing, empty, unreadable or truncated file, no triangles, and more than `MESH_BYTES` or
    `MESH_TRIANGLES`.
    """
    import trimesh

    check_format(path)
    if not path.is_file():
        raise InputError("no such file", where=path, remedy="check the path")
    if path.stat().st_size > MESH_BYTES:
        raise InputError(
            f"the file has {path.stat().st_size / 1e6:.0f} MB",
            where=path,
            expected=f"at most {MESH_BYTES / 1e6:.0f} MB",
            remedy="export a coarser mesh, in binary",
        )
    data, kind = path.read_bytes(), path.suffix[1:].lower()
    if not data.strip():
        raise InputError("the file is empty", where=path, remedy="export the mesh again")
    if kind == "stl":
        _check_whole_stl(data, path)
    if kind == "ply":
        _check_whole_text_ply(data, path)
    if kind == "obj":  # comments in other encodings are acceptable
        data = data.decode("utf-8", errors="replace").encode()
    try:
        loaded = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False)
    except Exception as error:  # the readers raise many kinds of exceptions
        raise InputError(
            f"not a readable {kind.upper()} mesh ({error})",
            where=path,
            remedy="check that the file is complete and is what its extension says; export it again",
        ) from error
    vertices, faces = getattr(loaded, "vertices", None), getattr(loaded, "faces", None)
    if vertices is None or faces is None or len(faces) == 0:
        raise InputError("the file holds no triangles", where=path, remedy="export a triangle mesh, not points")
    _check_count(len(faces), path)
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)


def _check_count(triangles: int, path: Path) -> None:
    if triangles > MESH_TRIANGLES:
        raise InputError(
            f"{triangles} triangles", where=path, expected=f"at most {MESH_TRIANGLES}", remedy="export a coarser mesh"
        )


def _check_whole_stl(data: bytes, path: Path) -> None:
    """Checks that a binary STL has as many triangles as its header states, and a text STL its last line."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count and count:
        _check_count(count, path)
        return
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(
            f"a truncated or damaged binary STL: its header promises {count} triangles, "
            f"{max(len(data) - 84, 0) // 50} follow",
            where=path,
            remedy="copy or export the file again",
        ) from None
    if text.lstrip().startswith("solid") and "endsolid" not in text[text.rfind("endfacet") :]:
        raise InputError(
            "a truncated text STL: it ends without endsolid", where=path, remedy="copy or export the file again"
        )


def _check_whole_text_ply(data: bytes, path: Path) -> None:
    """Checks that a text PLY has a line for each element of its header; for a binary PLY trimesh checks it."""
    header, end, body = data.partition(b"end_header")
    words = [line.split() for line in header.decode("latin-1").splitlines()]
    if not end or ["format", "ascii", "1.0"] not in words:
        return
    announced = [w[1:] for w in words if w[:1] == ["element"]]
    if not all(len(a) == 2 and a[1].isdecimal() and len(a[1]) < 20 for a in announced):
        raise InputError(
            "its header does not say how many vertices and faces there are", where=path, remedy="export the mesh again"
        )
    lines = sum(1 for line in body.splitlines() if line.strip())
    if lines != sum(int(count) for _, count in announced):
        promised = " and ".join(f"{count} of {name}" for name, count in announced)
        found = f"a truncated or damaged text PLY: its header promises {promised}, {lines} lines follow"
        raise InputError(found, where=path, remedy="copy or export the file again")
