"""The meshes of cases, by name: triangles without area, twice, turned, like needles; holes, forks, crossings.

What is broken is repaired as `pftwin doctor-mesh --repair` does it, or refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.doctor import repaired
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.studies.hard_cases.ground import TiltedGround, mesh_on

_PLACE = (0.004, 0.006)  # below the button, inside of a triangle [m]
_OVER_HOLE = (-0.005, 0.011)  # over the triangle that the hole takes out [m]

Vertices, Faces = NDArray[np.float64], NDArray[np.int64]
Change = Callable[[Vertices, Faces], tuple[Vertices, Faces]]


def _doctored(change: Change) -> Callable[[TiltedGround], SurfaceMesh]:
    """The ground's mesh, changed, and repaired as far as a repair leaves the surface what it is."""

    def made(ground: TiltedGround) -> SurfaceMesh:
        plain = mesh_on(ground)
        return repaired(*change(plain.vertices.copy(), plain.faces.copy()), source="a broken ground")[0]

    return made


def _with_faces(more: Callable[[Vertices, Faces], object]) -> Change:
    return lambda vertices, faces: (vertices, np.concatenate([faces, np.atleast_2d(np.asarray(more(vertices, faces)))]))


def _turned(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    faces[[2, 9, 14]] = faces[[2, 9, 14]][:, ::-1]
    return vertices, faces


def _needle(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """A corner a micrometre beside the middle of an edge of two triangles splits one of them in three, one a needle."""
    k = int(np.argmin(np.abs(vertices[faces].mean(axis=1)[:, :2] - np.array(_PLACE)).sum(axis=1)))
    a, b, c = faces[k]
    p = 0.5 * (vertices[a] + vertices[b])
    inward = vertices[c] - p
    new = len(vertices)
    vertices = np.concatenate([vertices, [p + 1e-6 * inward / np.linalg.norm(inward)]])
    rest = np.delete(faces, k, axis=0)
    return vertices, np.concatenate([rest, [[a, b, new], [b, c, new], [c, a, new]]])


def _hole(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    middles = vertices[faces].mean(axis=1)[:, :2]
    return vertices, np.delete(faces, np.argmin(np.linalg.norm(middles - np.array(_OVER_HOLE), axis=1)), axis=0)


def _fork(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """A third triangle stands on an edge of two."""
    vertices = np.concatenate([vertices, [[0.0, 0.015, 0.01]]])
    return vertices, np.concatenate([faces, [[faces[0, 0], faces[0, 2], len(vertices) - 1]]])


def _crossing(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
    """A loose sheet of two triangles cuts through the plate below the button."""
    sheet = np.array([[-0.02, 0.003, -0.0004], [0.02, 0.003, -0.0004], [0.02, 0.02, 0.0004], [-0.02, 0.02, 0.0004]])
    n = len(vertices)
    return np.concatenate([vertices, sheet]), np.concatenate([faces, [[n, n + 1, n + 2], [n, n + 2, n + 3]]])


def _one_triangle(ground: TiltedGround) -> SurfaceMesh:
    corners = np.array([[-0.03, -0.03, 0.0], [0.06, 0.0, 0.0], [-0.03, 0.03, 0.0]])
    return SurfaceMesh(corners, np.array([[0, 1, 2]]), "one triangle")


def _wide(ground: TiltedGround) -> SurfaceMesh:
    """A mesh that goes on where a patch does: by its edge a small button would roll over the rim on its way to rest."""
    return mesh_on(replace(ground, half=(0.03, 0.03)))


MESH_MAKERS: dict[str, Callable[[TiltedGround], SurfaceMesh]] = {
    "wide": _wide,
    "one_triangle": _one_triangle,
    "zero_area": _doctored(_with_faces(lambda v, f: [f[0, 0], f[0, 0], f[0, 1]])),
    "duplicate": _doctored(_with_faces(lambda v, f: f[[7, 7]])),
    "two_faced": _doctored(_with_faces(lambda v, f: f[5, ::-1])),
    "flipped": _doctored(_turned),
    "needles": _doctored(_needle),
    "hole": _doctored(_hole),
    "fork": _doctored(_fork),
    "crossing": _doctored(_crossing),
}
