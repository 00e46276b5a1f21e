"""Surfaces of bones for drawings of a scene. They do not affect forces or compiled programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh


@dataclass(frozen=True, eq=False)
class DrawnBones:
    """Surfaces of bones [m], keyed by body ("femur", "patella" or "tibia"), each in the frame of its body."""

    surfaces: Mapping[str, SurfaceMesh]

    def __eq__(self, other: object) -> bool:
        """Compares content, so that scenes with the same bones have the same structure."""
        if not isinstance(other, DrawnBones):
            return NotImplemented
        if self.surfaces.keys() != other.surfaces.keys():
            return False
        pairs = [(mesh, other.surfaces[body]) for body, mesh in self.surfaces.items()]
        return all(np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces) for a, b in pairs)

    def __hash__(self) -> int:
        return hash(tuple((body, mesh.vertices.shape) for body, mesh in self.surfaces.items()))
