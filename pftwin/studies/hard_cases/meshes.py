"""Cases of meshes: triangles without area, twice, turned, like needles; holes, forks, crossings; exactly on a feature.

What is broken is repaired as `pftwin doctor-mesh --repair` does it, or refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.case import RELEASED, Case, Expected
from pftwin.studies.hard_cases.contacts import MESHES
from pftwin.studies.hard_cases.ground import Ground, mesh_on
from pftwin.studies.hard_cases.knee import RADIUS, Knee
from pftwin.studies.hard_cases.touching import FREE
from pftwin.surfaces.mesh import SurfaceMesh
from pftwin.surfaces.mesh_repair import repaired

TOPIC = "meshes"
FLOOR = Ground(lambda u, v: 0.0 * u, (0.03, 0.03))
_PLACE = (0.004, 0.006)  # over the inside of a triangle [m]
# A button of triangles comes down on one of them: on a corner it would stand, and fall to a side by rounding alone.
_ON_A_FACE = (0.0, 0.087, 0.0)  # rotation vector [rad]
_OVER_HOLE = (-0.005, 0.011)  # over the triangle that the hole takes out [m]

Vertices, Faces = NDArray[np.float64], NDArray[np.int64]
Change = Callable[[Vertices, Faces], tuple[Vertices, Faces]]


def _doctored(change: Change) -> Callable[[Ground], SurfaceMesh]:
    """The ground's mesh, changed, and repaired as far as a repair leaves the surface what it is."""

    def made(ground: Ground) -> SurfaceMesh:
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


def _one_triangle(ground: Ground) -> SurfaceMesh:
    corners = np.array([[-0.03, -0.03, 0.0], [0.06, 0.0, 0.0], [-0.03, 0.03, 0.0]])
    return SurfaceMesh(corners, np.array([[0, 1, 2]]), "one triangle")


def _over(place: tuple[float, float], mesh: Callable[[Ground], SurfaceMesh] = mesh_on) -> Knee:
    """Let go half a millimetre above a place of the mesh [m]."""
    return replace(FREE, ground=FLOOR, start=(*place, RADIUS + 5e-4), turn=_ON_A_FACE, mesh=mesh)


def _case(
    name: str, about: str, knee: Knee, *, must: Status = RELEASED, same_as: str | None = None, group: str = "short"
) -> Case:
    expected = Expected(must=must, may=RELEASED, same_as=same_as)
    return Case(name, TOPIC, about, lambda: knee, expected, 5e-4, True, MESHES, group)


def _refused(name: str, about: str, change: Change, words: str) -> Case:
    knee = _over(_PLACE, _doctored(change))
    return Case(name, TOPIC, about, lambda: knee, Expected(refusal=words), released=True, contacts=MESHES)


CASES = (
    _case(
        "mesh_as_it_should_be",
        "A plate of 24 triangles, 20 mm long, below a button of 22 mm: the mesh that the others spoil.",
        _over(_PLACE),
    ),
    _case(
        "mesh_zero_area",
        "A triangle without area: left out, and nothing changes.",
        _over(_PLACE, _doctored(_with_faces(lambda v, f: [f[0, 0], f[0, 0], f[0, 1]]))),
        same_as="mesh_as_it_should_be",
    ),
    _case(
        "mesh_duplicate",
        "A triangle below the button is there twice: dropped, or contact would count it twice.",
        _over(_PLACE, _doctored(_with_faces(lambda v, f: f[[7, 7]]))),
        same_as="mesh_as_it_should_be",
    ),
    _case(
        "mesh_flipped",
        "Three triangles face the other side than their neighbours: turned.",
        _over(_PLACE, _doctored(_turned)),
        same_as="mesh_as_it_should_be",
    ),
    _case(
        "mesh_needles",
        "A needle of 20 mm by 1 um below the button: the same surface, and nearly no area to divide by.",
        _over(_PLACE, _doctored(_needle)),
        same_as="mesh_as_it_should_be",
    ),
    _case(
        "mesh_hole",
        "A triangle is missing where the button lands: it touches the hole's rim, and the frame says so.",
        replace(_over(_OVER_HOLE, _doctored(_hole)), turn=(0.0, 0.0, 0.0)),  # a corner of the button dips into it
        must=RELEASED | Status.LEFT_PATCH,
    ),
    _refused("mesh_non_manifold", "An edge of three triangles: refused by name.", _fork, "non_manifold_edge"),
    _refused(
        "mesh_two_faced",
        "A triangle lies on its own reverse: no outside, refused.",
        _with_faces(lambda v, f: f[5, ::-1]),
        "two_faced",
    ),
    _case(
        "mesh_self_intersection",
        "A loose sheet cuts through the plate below the button: two surfaces at one place, both bear.",
        _over(_PLACE, _doctored(_crossing)),
    ),
    _case("mesh_contact_on_vertex", "Lands exactly on a vertex of six triangles.", _over((0.01, 0.0))),
    _case("mesh_contact_on_edge", "Lands exactly on an edge inside one facet.", _over((0.0, 0.015))),
    _case(
        "mesh_contact_on_the_border",
        "Lands exactly on the edge between the medial and the lateral facet: one contact, not two.",
        _over((0.0, 0.0)),
    ),
    _case(
        "mesh_of_one_triangle",
        "A mesh of one triangle, all rim.",
        replace(_over((-0.005, 0.0), _one_triangle), facets=1),
        group="one triangle",
    ),
)
