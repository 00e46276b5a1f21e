"""Bones that a scene is drawn with. No force comes from them, and no program depends on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh


@dataclass(frozen=True, eq=False)
class DrawnBones:
    """Surfaces of bones [m] by body, "femur", "patella" or "tibia", each in its body's frame."""

    surfaces: Mapping[str, SurfaceMesh]
