"""Closed surfaces of femur, patella and tibia of an anatomy, and the parts of them that articulate."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.rig.natural.anatomy import Anatomy
from pftwin.rig.natural.femur import FemurBody
from pftwin.rig.natural.implicit import mesh_of
from pftwin.rig.natural.patella import PatellaBody
from pftwin.rig.natural.tibia import TibiaBody


class Bones(NamedTuple):
    """Closed meshes with outward normals [m], in the frames of their bodies; cartilage counts as bone."""

    femur: SurfaceMesh
    patella: SurfaceMesh
    tibia: SurfaceMesh


@lru_cache(maxsize=16)
def bones(anatomy: Anatomy, resolution_mm: float = 1.5) -> Bones:
    """The surfaces of an anatomy.

    Args:
        anatomy: its numbers.
        resolution_mm: size of the triangles, 0.1 to 5 mm.

    Raises:
        InputError: a resolution out of range, or too coarse for the anatomy.
    """
    parts = (("femur", FemurBody(anatomy)), ("patella", PatellaBody(anatomy)), ("tibia", TibiaBody(anatomy)))
    return Bones(*(mesh_of(body, *body.box(), resolution_mm, f"natural {name}") for name, body in parts))
