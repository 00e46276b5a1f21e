"""Compiled programs that run the cases: scenes have one structure, so each integrator and float type compiles once.

Cases run one after the other through a program of one case, with the number of steps as an argument, so no case waits
for the one with the shortest steps. The penetration depth is computed by an exhaustive search that is independent of
time stepping, contact memory and search trees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Pose, Scalar, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import first_guide, frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.state import State, System
from pftwin.dynamics.static_load import patella_at_rest
from pftwin.geometry.bvh.triangle import Triangle, closest_on_triangle
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.model.effects.contact import Contact
from pftwin.model.scene import Scene

# Few LLVM optimisations: all take long to compile, but without any, contours of meshes run four times as long.
OPTIONS = {"xla_backend_optimization_level": 1}
PARAMETERS = ("quadriceps stiffness", "patellar tendon's slack length", "height of the surface", "contact stiffness")
UNITS = (1.0, 1e-2, 1e-3, 1.0)  # units of the changes of the parameters: relative, [m], [m], relative


class Rest(eqx.Module):
    """Starting states of a scene."""

    equilibrium: Solution
    released: Solution  # the scene's start pose, not in equilibrium
    slopes: Array  # (7, 4) derivatives of the equilibrium's position and quaternion by `PARAMETERS`


class CaseRun(eqx.Module):
    """The results of a run; the leading axis is the frame."""

    states: State
    observation: Observation
    ledger: Ledger


def with_parameters(scene: Scene, p: Array) -> Scene:
    """Returns the scene with its parameters changed by p (4,), in `UNITS`."""
    quadriceps, tendon, button = (scene.index(n) for n in ("quadriceps", "patellar_tendon", "contact"))

    def numbers(s: Any) -> tuple[Any, Any, Any]:
        return s.effects[quadriceps].stiffness, s.effects[tendon].slack_length, s.effects[button].law.contact_stiffness

    stiffness, slack, hardness = numbers(scene)
    changed = stiffness * (1 + UNITS[0] * p[0]), slack + UNITS[1] * p[1], hardness * (1 + UNITS[3] * p[3])
    scene = eqx.tree_at(numbers, scene, changed)
    assert scene.contact is not None  # every case has one
    return scene.with_effect(_raised(scene.contact, UNITS[2] * p[2]))


def _raised(contact: Contact, by: Array) -> Contact:
    """The contact with its fitted surface raised by `by` [m]; for a mesh, the button is lowered instead."""
    surface: Any = contact.fitted_surface()
    if surface is None:
        return contact.with_button_moved(Vec3(jnp.zeros_like(by), jnp.zeros_like(by), -by))
    only = isinstance(surface, PolynomialPatch)  # its first coefficient is the height; a spline needs all of them
    change = by * jnp.eye(1, surface.coefficients.size)[0] if only else by  # pyright: ignore
    return contact.with_fitted_surface(eqx.tree_at(lambda s: s.coefficients, surface, surface.coefficients + change))


def poses(states: State | Pose) -> Array:
    """Returns position [m] and quaternion as one array (..., 7)."""
    return jnp.concatenate([states.position.array(), states.orientation.array()], axis=-1)


def _columns(function: Callable[[Array], Array]) -> Array:
    """Derivatives by p at p = 0, with the parameters as the last axis; a loop over columns compiles only once."""
    zero = jnp.zeros(len(PARAMETERS))
    columns = jax.lax.map(lambda d: jax.jvp(function, (zero,), (d,))[1], jnp.eye(len(PARAMETERS)))
    return jnp.moveaxis(columns, 0, -1)


def equilibrium_with_derivatives(scene: Scene, p: Array) -> Rest:
    """Returns the scene's equilibrium with its derivatives, and its start pose."""

    def found(change: Array) -> Array:
        return poses(starting_equilibrium(with_parameters(scene, p + change)).pose)

    changed = with_parameters(scene, p)
    pose, solution = scene.center_of_mass_pose(), starting_equilibrium(changed)
    memories = System.of(scene).remember(patella_at_rest(first_guide(scene), pose))
    zero = jnp.zeros_like(solution.residual)
    released = Solution(pose, memories, zero + jnp.inf, 0 * solution.iterations, 0 * solution.stiffness, zero)
    return Rest(solution, released, _columns(found))


def run(scene: Scene, start: Solution, substeps: Array, p: Array, integrator: Integrator) -> CaseRun:
    """Simulates a scene with its energy ledger and all observations."""
    changed = with_parameters(scene, p)
    path = frame_states(changed, integrator=integrator, substeps=substeps, start=start, ledger=True)
    assert path.ledger is not None
    return CaseRun(path.states, observe(changed, path), path.ledger)


def depths(scene: Scene, centers: Vec3) -> Array:
    """Returns the button's penetration (n,) [m] at positions of its centre, by exhaustive search."""
    button = System.of(scene).effects[scene.index("contact")].contact_role()
    assert button is not None
    return jax.lax.map(lambda c: depth_everywhere(button, c), centers)


def slopes(scene: Scene, start: Solution, substeps: Array, integrator: Integrator) -> Array:
    """Returns derivatives (n, 7, 4) of the frames' poses by `PARAMETERS`, from a fixed start."""

    def path(p: Array) -> Array:
        changed = with_parameters(scene, p)
        return poses(frame_states(changed, integrator=integrator, substeps=substeps, start=start).states)

    return _columns(path)


@lru_cache(maxsize=256)
def compiled(function: Callable[..., Any], float64: bool, **fixed: Any) -> Callable[..., Any]:
    """Returns a function that runs a program of one case on the members of a batch in turn, cached per float type.

    It takes stacked arguments, and `only`, the indices of the members to run (default: all). Results are stacked on
    the host.
    """
    program = jax.jit(partial(function, **fixed), compiler_options=OPTIONS)

    def each(*stacked: Any, only: Sequence[int] | None = None) -> Any:
        args = jax.device_get(stacked)
        which = range(len(jax.tree.leaves(args)[0])) if only is None else only
        found = [jax.device_get(program(*jax.tree.map(lambda a, k=k: a[k], args))) for k in which]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *found)

    return each


SAMPLES = 61  # along each side of a square around the point below the centre
WIDE = 1.5  # initial half side of that square, in radii
ZOOMS = 4  # number of times that the square shrinks around the nearest sample


def depth_everywhere(button: Contact, center: Vec3) -> Array:
    """Returns the sphere's radius minus the signed distance of its centre to the surface [m]; negative: no contact.

    A centre below a patch counts as inside. For a mesh, the normal of the nearest triangle decides, but an open mesh
    has no inside past its rim.

    `button` must be prepared by `recentred`; `center` is the sphere's centre in the femur frame.
    """
    surface, femur, corners = button.fitted_surface(), button.femur_triangles(), button.button_triangles()
    radius = button.button_radius() if corners is None else jnp.max(Vec3.from_array(corners.reshape(-1, 3)).norm())
    if surface is not None:
        return radius - _above_patch(surface, center, radius)
    assert femur is not None
    return radius - _above_mesh(femur, center)


def _above_patch(surface: Any, center: Vec3, radius: Scalar) -> Array:
    """Signed distance [m] by sampling two squares, one below the centre and one on the patch, each shrunk repeatedly.

    On a cylinder, a square goes round the axis at most once, and points on or beyond the axis do not count as surface.
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
    below, beside = (_signed(surface, c, u, v) for u, v, *_ in found)
    return jnp.where(jnp.abs(below) < jnp.abs(beside), below, beside)


def _signed(surface: Any, c: Vec3, u: Array, v: Array) -> Array:
    """Distance of a point in the chart's frame from the surface point at (u, v), negative if below [m]."""
    jet = surface.jet(u, v)
    away = _away(surface, c, u, v)
    return jnp.where(away.dot(surface.chart.normal(u, jet.f, jet.u, jet.v)) < 0, -away.norm(), away.norm())


def _away(surface: Any, c: Vec3, u: Array, v: Array) -> Vec3:
    """Vectors from surface points to the centre."""
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
    """Whether a point (3,) of a mesh lies on a boundary edge: one without an opposite edge of another triangle."""
    corners = rows.reshape(-1, 3, 3)
    a, b = corners.reshape(-1, 3), jnp.roll(corners, -1, axis=1).reshape(-1, 3)
    met = ((a[:, None] == b[None]) & (b[:, None] == a[None])).all(axis=-1).any(axis=1)
    along = b - a
    length = jnp.maximum((along * along).sum(axis=-1), jnp.finfo(rows.dtype).tiny)
    share = jnp.clip(((point[None] - a) * along).sum(axis=-1) / length, 0.0, 1.0)
    off = jnp.linalg.norm(a + share[:, None] * along - point[None], axis=-1)
    near = 100 * jnp.finfo(rows.dtype).eps * jnp.abs(rows).max()
    return (~met & (off <= near)).any()
