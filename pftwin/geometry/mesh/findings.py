"""The individual checks of the mesh doctor and the descriptions of what they find."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.mesh.topology import MeshPart, agreement, edges_of

FEW = 0.25  # largest share of an open part's triangles that may be reversed to make the part consistent
INWARD = -0.3  # mean cosine between normals and directions from the part's centre, below which normals point inward


@dataclass(frozen=True)
class MeshFinding:
    """A fault of a mesh, or a property worth reporting."""

    kind: str  # "mixed_winding", "hole", ...
    severity: str  # "safe", "left" or "fatal"
    count: int
    words: str  # description
    places: list[list[float]] = field(default_factory=list)  # coordinates of the first five, in the file's unit


def _finding_at(kind: str, severity: str, words: str, places: NDArray) -> list[MeshFinding]:
    """A list of one finding at points (k, 3), the words preceded by their number; an empty list for k = 0."""
    n = len(places)
    return [MeshFinding(kind, severity, n, f"{n} {words}", places[:5].tolist())] if n else []


def superfluous_triangles(
    points: NDArray, faces: NDArray, flat: NDArray[np.bool_], copies: NDArray[np.bool_], opposed: NDArray[np.bool_]
) -> list[MeshFinding]:
    """Findings on triangles with zero area, and on duplicates with the same or the opposite orientation."""

    def found(which: NDArray[np.bool_], kind: str, severity: str, words: str) -> list[MeshFinding]:
        return _finding_at(kind, severity, f"triangles {words}", points[faces[which]].mean(axis=1))

    sheet = "lie on their own reverse: a sheet without thickness has no outside; remove one"
    return [
        *found(flat, "zero_area", "safe", "have no area; without them the surface is the same"),
        *found(copies, "duplicate", "safe", "are there more than once; contact would count them twice"),
        *found(opposed, "two_faced", "fatal", sheet),
    ]


def crowded_edges(mesh: SurfaceMesh) -> list[MeshFinding]:
    """Findings on edges that border more than two triangles."""
    edges = edges_of(mesh.faces)
    middles = mesh.vertices[edges.corners[edges.count > 2]].mean(axis=1)
    words = "edges border more than two triangles: the mesh is no surface there; take the extra sheet out"
    return _finding_at("non_manifold_edge", "fatal", words, middles)


def wrongly_turned(mesh: SurfaceMesh, parts: list[MeshPart]) -> tuple[NDArray[np.bool_], list[MeshFinding]]:
    """Which faces to reverse, (m,) bool, and the findings on orientation."""
    turned, one_sided, _ = agreement(mesh.faces)
    centers = mesh.vertices[mesh.faces].mean(axis=1)
    mixed = turned.copy()  # faces oriented against their neighbours
    counts, places = dict.fromkeys(_SIDES, 0), {kind: [] for kind in _SIDES}
    for part in parts:
        own, outward = part.faces, np.where(turned[part.faces], -1.0, 1.0)[:, None] * mesh.area_vectors[part.faces]
        arms = centers[own] - part.center
        kind = None
        if one_sided[own].any():
            continue
        if not part.loops:
            if np.einsum("ij,ij->", arms, outward) < 0:
                kind = "cavity" if _inside(part, parts, mesh) else "flipped"
        elif turned[own].mean() > FEW:
            kind = "ambiguous_winding"
        else:
            weights = np.linalg.norm(arms, axis=1) * mesh.face_areas[own]
            if np.einsum("ij,ij->", arms, outward) < INWARD * weights.sum():
                kind = "inward"
        if kind is not None:
            counts[kind] += len(own)
            places[kind].append(part.center.tolist())
        if kind == "flipped":
            turned[own] = ~turned[own]
    for kind, which in (("one_sided", one_sided), ("mixed_winding", mixed)):
        counts[kind], places[kind] = int(which.sum()), centers[which][:5].tolist()
    said = [
        MeshFinding(k, s, counts[k], w.format(counts[k]), places[k][:5]) for k, (s, w) in _SIDES.items() if counts[k]
    ]
    return turned, said


_SIDES = {
    "one_sided": ("fatal", "{} triangles belong to a surface with one side only (a Moebius strip): take the extra out"),
    "mixed_winding": ("safe", "{} triangles face the other side than their neighbours"),
    "ambiguous_winding": (
        "fatal",
        "an open surface of {} triangles whose orientation is too inconsistent to find its outside: orient it first",
    ),
    "flipped": ("safe", "a closed part of {} triangles is inside out"),
    "cavity": ("left", "a closed part of {} triangles inside another one faces inward: treated as a cavity"),
    "inward": (
        "left",
        "an open surface of {} triangles mostly faces its own middle: if that is where the bone is, it is inside out "
        "(mesh.flipped() turns it)",
    ),
}


def _inside(part: MeshPart, parts: list[MeshPart], mesh: SurfaceMesh) -> bool:
    """Whether this part's bounding box lies in that of another closed part."""
    low, high = _box(part, mesh)
    others = [_box(other, mesh) for other in parts if other is not part and not other.loops]
    return any((a <= low).all() and (high <= b).all() for a, b in others)


def _box(part: MeshPart, mesh: SurfaceMesh) -> tuple[NDArray, NDArray]:
    corners = mesh.vertices[mesh.faces[part.faces].ravel()]
    return corners.min(axis=0), corners.max(axis=0)


def holes(mesh: SurfaceMesh, parts: list[MeshPart]) -> list[MeshFinding]:
    """Findings on short boundary loops; long loops are the rims of an open surface and no fault."""
    holes = [loop for part in parts for loop in part.loops if loop.is_hole]
    longest = max((k.length for k in holes), default=0.0)
    words = f"holes, {'' if len(holes) == 1 else 'up to '}{longest:.3g} around: nothing touches there"
    return _finding_at(
        "hole", "left", f"{words}; filling them would invent surface", np.array([k.center for k in holes])
    )


def isolated_parts(mesh: SurfaceMesh, parts: list[MeshPart]) -> list[MeshFinding]:
    """Findings on all parts but the largest."""
    rest = parts[1:]
    share = sum(p.area for p in rest) / mesh.area
    words = (
        f"parts with {100 * share:.2g} % of the area are not connected to the largest: "
        "contact counts them; remove them in a mesh editor if they are debris"
    )
    return _finding_at("isolated_part", "left", words, np.array([p.center for p in rest]))


def scale(longest: float, likely: list[str], units: str | None) -> list[MeshFinding]:
    """A finding if the size is implausible for a part of the knee in the stated unit (None: in any unit)."""
    if units in likely or (units is None and likely):
        return []
    stated = "any unit" if units is None else units
    guess = f"; in {likely[0]} it is" if likely else ""
    words = f"a longest side of {longest:.4g} is not the size of a part of the knee in {stated}{guess}"
    return [MeshFinding("scale", "left", 1, words)]
