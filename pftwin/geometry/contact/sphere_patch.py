"""The patch of a mesh inside a sphere: area, depth and normal of each facet's part.

The sums over a patch are exact for the mesh's flat triangles (`pftwin.geometry.contact.ball_cut`). Parts of the surface
wholly inside are summed by nodes of a tree with precomputed areas, first and second moments; only triangles along the
patch's outline are cut individually (`pftwin.geometry.bvh.wide`).

Values come from loops over the triangles found. Derivatives by the mesh are those of the same sums over lists of fixed
length, which support both modes of differentiation; derivatives by the sphere are sums over the outline.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.leaves import filled_tangents
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.loops import member_by_member
from pftwin.geometry.bvh.triangle import Triangle
from pftwin.geometry.bvh.wide import InBall, in_ball
from pftwin.geometry.contact.ball_cut import BallArcs, BallCut, ball_arcs, ball_cut
from pftwin.geometry.contact.patch_mesh import CHUNK, PatchMesh, SeamDepth, seam_depth


class PatchSums(NamedTuple):
    """Sums over the parts of each facet, medial and lateral, inside the sphere."""

    facets: tuple[BallCut, BallCut]  # with the sphere's centre as origin
    seam: SeamDepth  # along the border of the facets


class Patch(NamedTuple):
    """The sums, and whether they are complete."""

    sums: PatchSums
    overflow: Array  # bool: the lists were too short, the sums are incomplete


def sphere_patch(mesh: PatchMesh, center: Vec3, radius: Scalar) -> Patch:
    """The patch inside a sphere, its centre in the mesh's frame [m]. Supports jit, vmap and derivatives."""
    ready = mesh if mesh.sums is not None else mesh.prepared()
    return _patch(ready, center, radius)


@eqx.filter_custom_jvp
def _patch(mesh: PatchMesh, center: Vec3, radius: Scalar) -> Patch:
    return member_by_member(_counted)(mesh, center, radius)


@_patch.def_jvp
def _patch_jvp(primals: Any, tangents: Any) -> tuple[Patch, Patch]:
    """By the sphere's centre and radius: sums over the outline. By the mesh: sums over lists of fixed length."""
    mesh, center, radius = primals
    patch = _patch(mesh, center, radius)
    of_mesh, of_sphere = tangents[0], tuple(tangents[1:])
    parts = []
    if jax.tree.leaves(of_sphere):
        arcs = _outline_arcs(mesh, center, radius)
        dc, dr = filled_tangents((center, radius), of_sphere)
        cuts = [_moved(cut, arc, radius, dc, dr) for cut, arc in zip(patch.sums.facets, arcs, strict=True)]
        seam = eqx.filter_jvp(lambda c, r: seam_depth(mesh.seam, c, r), (center, radius), (dc, dr))[1]
        parts.append(PatchSums((cuts[0], cuts[1]), seam))
    if jax.tree.leaves(of_mesh):
        found = in_ball(mesh.facets.wide, center, radius, mesh.room)
        parts.append(eqx.filter_jvp(lambda m: _sums_by_lists(m, center, radius, found), (mesh,), (of_mesh,))[1])
    return patch, Patch(jax.tree.map(lambda *x: sum(x[1:], start=x[0]), *parts), None)  # pyright: ignore


def _moved(cut: BallCut, arcs: BallArcs, radius: Scalar, dc: Vec3, dr: Scalar) -> BallCut:
    """Change of the sums by a change of the centre and the radius; zero for the flux, which only decides the side."""
    grown = radius * dr
    turned = Vec3(*(row.dot(dc) for row in arcs.product))
    return BallCut(
        arcs.moment.dot(dc) + grown * arcs.turned,
        2 * cut.moment.dot(dc) + 2 * grown * cut.area,
        turned - cut.area * dc + grown * arcs.moment,
        jnp.zeros_like(cut.flux),
    )


@eqx.filter_custom_jvp
def _outline_arcs(mesh: PatchMesh, center: Vec3, radius: Scalar) -> tuple[BallArcs, BallArcs]:
    """Integrals over the outline's arcs on the medial and the lateral facet."""

    def search(mesh: PatchMesh, center: Vec3, radius: Scalar) -> Array:
        found = in_ball(mesh.facets.wide, center, radius, mesh.room)
        return _over_triangles(mesh, found, center, radius, _arcs_of)

    medial, lateral = member_by_member(search)(mesh, center, radius)
    return _ball_arcs_of(medial), _ball_arcs_of(lateral)


@_outline_arcs.def_jvp
def _arcs_jvp(primals: Any, tangents: Any) -> Any:
    raise NotImplementedError("a sphere on a mesh has no third derivatives of its volume")


def _counted(mesh: PatchMesh, center: Vec3, radius: Scalar) -> Patch:
    """The sums by loops over the triangles and nodes found."""
    found = in_ball(mesh.facets.wide, center, radius, mesh.room)

    def one_node(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        i, whole, lateral = state
        node = jax.lax.dynamic_index_in_dim(found.inside, i, keepdims=False)
        row = jax.lax.dynamic_index_in_dim(mesh.sums, node, keepdims=False)
        return i + 1, whole + row, lateral + row[9] * row

    total = _over_triangles(mesh, found, center, radius, _cut_of)
    n_inside = jnp.minimum(found.n_inside, mesh.room.inside)
    start = jnp.zeros((), jnp.int32), jnp.zeros(10, radius.dtype), jnp.zeros(10, radius.dtype)
    _, whole, lateral = jax.lax.while_loop(lambda s: s[0] < n_inside, one_node, start)
    groups = whole - lateral, lateral
    medial, lateral = (total[k] + _from_origin(x, center, radius) for k, x in enumerate(groups))
    both = (medial[0] > 0) & (lateral[0] > 0)
    seam = jax.lax.cond(both, lambda: seam_depth(mesh.seam, center, radius), lambda: _no_seam(radius))
    return Patch(PatchSums((_ball_cut_of(medial), _ball_cut_of(lateral)), seam), found.overflow())


def _over_triangles(
    mesh: PatchMesh, found: InBall, center: Vec3, radius: Scalar, what: Callable[[Triangle, Scalar], tuple[Scalar, ...]]
) -> Array:
    """Sums of k quantities over the triangles on the outline, medial and lateral, (2, k), a chunk at a time."""
    cut = jnp.concatenate([found.cut, jnp.zeros(CHUNK, jnp.int32)])
    lanes = jnp.arange(CHUNK, dtype=jnp.int32)
    end = jnp.minimum(found.n_cut, mesh.room.cut)

    def add(state: tuple[Array, Array]) -> tuple[Array, Array]:
        i, total = state
        some = jax.lax.dynamic_slice_in_dim(cut, i, CHUNK)
        return i + CHUNK, total + _group_sums(mesh, some, i + lanes < end, center, radius, what)

    none = jax.eval_shape(add, (end, jnp.zeros((), radius.dtype)))[1]
    start = jnp.zeros((), jnp.int32), jnp.zeros(none.shape, none.dtype)
    return jax.lax.while_loop(lambda s: s[0] < end, add, start)[1]


def _sums_by_lists(mesh: PatchMesh, center: Vec3, radius: Scalar, found: InBall) -> PatchSums:
    """The same sums over lists of fixed length."""
    listed = jnp.arange(mesh.room.cut, dtype=jnp.int32) < found.n_cut
    total = _group_sums(mesh, found.cut, listed, center, radius, _cut_of)
    listed = jnp.arange(mesh.room.inside, dtype=jnp.int32) < found.n_inside
    rows = jnp.where(listed[:, None], mesh.sums[found.inside], 0.0)  # pyright: ignore[reportOptionalSubscript]
    lateral = rows[:, 9] @ rows
    groups = rows.sum(axis=0) - lateral, lateral
    medial, lateral = (total[k] + _from_origin(x, center, radius) for k, x in enumerate(groups))
    return PatchSums((_ball_cut_of(medial), _ball_cut_of(lateral)), seam_depth(mesh.seam, center, radius))


def _group_sums(
    mesh: PatchMesh,
    places: Array,
    counted: Array,
    center: Vec3,
    radius: Scalar,
    what: Callable[[Triangle, Scalar], tuple[Scalar, ...]],
) -> Array:
    """Sums of k quantities over the triangles in places, medial and lateral, (2, k), with the centre as origin."""
    rows = mesh.facets.triangles[places] - jnp.stack([center.x, center.y, center.z] * 3)[None, :]
    values = what(Triangle.of_rows(rows), radius)
    half = len(mesh.facets.triangles) // 2 if mesh.facets.count > 1 else len(mesh.facets.triangles)
    groups = counted & (places < half), counted & (places >= half)
    return jnp.stack([jnp.stack([jnp.where(on, v, 0.0).sum() for v in values]) for on in groups])


def _cut_of(t: Triangle, radius: Scalar) -> tuple[Scalar, ...]:
    return tuple(jax.tree.leaves(ball_cut(t, radius)))  # in the order of `BallCut`, as `_ball_cut_of` takes them


def _arcs_of(t: Triangle, radius: Scalar) -> tuple[Scalar, ...]:
    arcs = ball_arcs(t, radius)
    a, b, c = arcs.product
    return arcs.turned, arcs.moment.x, arcs.moment.y, arcs.moment.z, a.x, a.y, a.z, b.y, b.z, c.z


def _ball_arcs_of(v: Array) -> BallArcs:
    rows = Vec3(v[4], v[5], v[6]), Vec3(v[5], v[7], v[8]), Vec3(v[6], v[8], v[9])
    return BallArcs(v[0], Vec3(v[1], v[2], v[3]), rows)


def _from_origin(s: Array, c: Vec3, radius: Scalar) -> Array:
    """Converts sums over whole triangles (10,) to those of `BallCut` about a ball's centre, (6,)."""
    first, n = Vec3(s[1], s[2], s[3]), Vec3(s[5], s[6], s[7])
    doubled = s[0] * (radius * radius - c.squared_norm()) + 2 * first.dot(c) - s[4]
    moment = first - s[0] * c
    return jnp.stack([s[0], doubled, moment.x, moment.y, moment.z, s[8] - n.dot(c)])


def _ball_cut_of(values: Array) -> BallCut:
    return BallCut(values[0], values[1], Vec3(values[2], values[3], values[4]), values[5])


def _no_seam(x: Scalar) -> SeamDepth:
    zero = jnp.zeros_like(x)
    nowhere = Vec3(zero, zero, zero)
    return SeamDepth(zero, zero, zero, nowhere, nowhere)
