"""How deep a button is in a surface by an exhaustive search, which no time stepping, memory or tree can lead astray."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.model.effects.contact import Contact

SAMPLES = 61  # along each side of a square about the point below the centre
WIDE = 1.5  # half that square's side at first, in radii
ZOOMS = 4  # times that the square is drawn closer about the nearest sample


def depth_everywhere(button: Contact, center: Vec3) -> Array:
    """Radius less the distance of the sphere's centre to the nearest point of the surface [m].

    Negative where it touches nothing. A centre below a patch counts as inside; a mesh's side is told by its nearest
    triangle's normal, but a mesh that is open has no inside past its rim.

    Args:
        button: a contact, made ready by `recentred`.
        center: of the sphere, femur frame [m].
    """
    surface, femur, corners = button.fitted_surface(), button.femur_triangles(), button.button_triangles()
    radius = button.button_radius() if corners is None else jnp.max(Vec3.from_array(corners.reshape(-1, 3)).norm())
    if surface is not None:
        return radius - _above_patch(surface, center, radius)
    assert femur is not None
    return radius - _above_mesh(femur, center)


def _above_patch(surface: Any, center: Vec3, radius: Scalar) -> Array:
    """By samples of two squares, one below the centre and one over the patch, each drawn closer about its nearest.

    Over a cylinder a square goes round the axis once at most, and what lies on the axis or beyond is no surface.
    """
    c = surface.chart.to_frame(center)
    side = jnp.linspace(-1.0, 1.0, SAMPLES)
    grid_u, grid_v = (g.ravel() for g in jnp.meshgrid(side, side))
    turn = jnp.pi * surface.chart.radius if isinstance(surface.chart, CylindricalChart) else jnp.inf

    def closer(_: int, place: tuple[Array, ...]) -> tuple[Array, ...]:
        u0, v0, half_u, half_v = place
        u, v = u0 + half_u * grid_u, v0 + half_v * grid_v
        square = _away(surface, c, u, v).squared_norm()
        if isinstance(surface.chart, CylindricalChart):
            square = jnp.where(jax.vmap(surface.height)(u, v) > 0, square, jnp.inf)
        k = jnp.argmin(square)
        return u[k], v[k], half_u * (4 / SAMPLES), half_v * (4 / SAMPLES)

    places = (surface.chart.foot(c), WIDE * radius), (surface.center, WIDE * jnp.maximum(*surface.half_size))
    squares = [(*middle, jnp.minimum(half, turn), half) for middle, half in places]
    found = [jax.lax.fori_loop(0, ZOOMS, closer, square) for square in squares]
    return jnp.where(
        jnp.abs(_signed(surface, c, *found[0][:2])) < jnp.abs(_signed(surface, c, *found[1][:2])),
        _signed(surface, c, *found[0][:2]),
        _signed(surface, c, *found[1][:2]),
    )


def _signed(surface: Any, c: Vec3, u: Array, v: Array) -> Array:
    """The distance of a point of the chart's frame to the surface's at (u, v), negative where it is below [m]."""
    jet = surface.jet(u, v)
    away = _away(surface, c, u, v)
    return jnp.where(away.dot(surface.chart.normal(u, jet.f, jet.u, jet.v)) < 0, -away.norm(), away.norm())


def _away(surface: Any, c: Vec3, u: Array, v: Array) -> Vec3:
    """From the surface's points to the centre."""
    p = surface.chart.local_point(u, v, jax.vmap(surface.height)(u, v) if jnp.ndim(u) else surface.height(u, v))
    p = Vec3(*(jnp.broadcast_to(a, jnp.shape(u)) for a in (p.x, p.y, p.z)))
    return Vec3(c.x - p.x, c.y - p.y, c.z - p.z)


def _above_mesh(rows: Array, center: Vec3) -> Array:
    triangles = Triangle.of_rows(rows)

    def one(t: Triangle) -> tuple[Array, Array]:
        away = center - closest_on_triangle(t, center).point
        return away.norm(), away.dot(t.area_vector())

    distance, side = jax.vmap(one)(triangles)
    k = jnp.argmin(distance)
    nearest = closest_on_triangle(jax.tree.map(lambda a: a[k], triangles), center).point.array()
    return jnp.where((side[k] < 0) & ~_on_rim(rows, nearest), -distance[k], distance[k])


def _on_rim(rows: Array, point: Array) -> Array:
    """Whether a point (3,) of a mesh lies on an edge along which no other triangle runs the other way."""
    corners = rows.reshape(-1, 3, 3)
    a, b = corners.reshape(-1, 3), jnp.roll(corners, -1, axis=1).reshape(-1, 3)
    met = ((a[:, None] == b[None]) & (b[:, None] == a[None])).all(axis=-1).any(axis=1)
    along = b - a
    length = jnp.maximum((along * along).sum(axis=-1), jnp.finfo(rows.dtype).tiny)
    share = jnp.clip(((point[None] - a) * along).sum(axis=-1) / length, 0.0, 1.0)
    off = jnp.linalg.norm(a + share[:, None] * along - point[None], axis=-1)
    near = 100 * jnp.finfo(rows.dtype).eps * jnp.abs(rows).max()
    return (~met & (off <= near)).any()
