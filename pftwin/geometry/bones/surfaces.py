"""Closed surfaces of the femur, patella and tibia of an anatomy, and the articulating parts of them."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.geometry.bones.anatomy import Anatomy
from pftwin.geometry.bones.implicit import mesh_of
from pftwin.geometry.bones.patella import PatellaShape
from pftwin.geometry.bones.tibiofemoral import FemurShape, TibiaShape
from pftwin.geometry.mesh.mesh import SurfaceMesh, compacted

_SHAPES: dict[str, type[FemurShape | PatellaShape | TibiaShape]] = {
    "femur": FemurShape,
    "patella": PatellaShape,
    "tibia": TibiaShape,
}


class Bones(NamedTuple):
    """Closed meshes with outward normals [m], in the frames of their bodies; cartilage counts as bone."""

    femur: SurfaceMesh
    patella: SurfaceMesh
    tibia: SurfaceMesh


@lru_cache(maxsize=16)
def bones(anatomy: Anatomy, resolution_mm: float = 1.5) -> Bones:
    """Meshes the bones of an anatomy.

    Args:
        anatomy: the anatomical parameters.
        resolution_mm: size of the triangles, 0.4 to 5 mm; the patella's are half as large.

    Raises:
        InputError: a resolution out of range, or too coarse for the anatomy; an anatomy without a valid patella.
    """
    if not 0.4 <= resolution_mm <= 5:
        raise InputError(f"found {resolution_mm!r}", where="resolution_mm", expected="0.4 to 5 mm")
    fine = {"femur": resolution_mm, "patella": 0.5 * resolution_mm, "tibia": resolution_mm}
    numbers = dataclasses.asdict(anatomy)
    return Bones(**{n: SurfaceMesh(*cached(_meshed, n, numbers, fine[n], files=()), f"natural {n}") for n in _SHAPES})


def articular(made: Bones) -> tuple[SurfaceMesh, SurfaceMesh]:
    """Articulating parts of femur (trochlea, condyles, front of the shaft) and patella (back)."""
    femur, patella = made.femur, made.patella
    x, _, z = femur.vertices[femur.faces].mean(axis=1).T
    angle = np.degrees(np.arctan2(x, z))
    reached = (angle > -120) & (angle < 90) & (x < 0.055)
    back = patella.area_vectors[:, 2] < -0.5 * patella.face_areas
    return (
        compacted(SurfaceMesh(femur.vertices, femur.faces[reached], "femoral cartilage")),
        compacted(SurfaceMesh(patella.vertices, patella.faces[back], "patellar cartilage")),
    )


def _meshed(name: str, numbers: dict[str, float], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    body = _SHAPES[name](Anatomy(**numbers))
    mesh = mesh_of(body, *body.box(), spacing, f"natural {name}")
    return mesh.vertices, mesh.faces
