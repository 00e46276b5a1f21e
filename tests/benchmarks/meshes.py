"""Contact of meshes: single queries beside collision libraries, growth with triangles, whole motions.

Queries are timed inside one compiled loop over many poses, as a simulation asks them; a call from Python would cost
more than the query. Peers are asked from Python, through their own interface, as their users do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.simulate import settle_first_frame
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.contact.contour import mesh_pair
from pftwin.geometry.contact.patch_mesh import lateral_of_groove, patch_mesh
from pftwin.geometry.contact.sphere_patch import sphere_patch
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.implant import rig_implant, rig_region
from pftwin.model.scene import Scene
from pftwin.rig import geometry as rig
from tests.benchmarks.clock import measure, measure_in_turn
from tests.benchmarks.mesh_peers import peers
from tests.benchmarks.problem import compiled, duration, tracked_path
from tests.benchmarks.row import Row

TOPIC = "meshes"
BUTTON = 16  # frequency of the button's icosphere: 5,120 triangles
BATCH = 64
SIZES = {"3k": 0.056e-3, "28k": 0.006e-3, "100k": 0.00167e-3}  # deviations of meshes of about so many triangles [m]
MOTIONS = {"CM": 10.0, "FM": 5.0, "volume": 40.0}  # x real time wanted
LEVEL = 5e-5  # rms distance from the converged motion that a step may cost [m]
Query = Callable[[Any, Pose], Any]


def rows(count: int = 200, *, whole_motions: bool = True) -> list[Row]:
    """All figures of the topic.

    Args:
        count: poses of a query.
        whole_motions: whether to simulate as well.
    """
    made = {name: rig_implant().mesh(deviation=deviation) for name, deviation in SIZES.items()}
    out = _queries(made["28k"], count) + _growth(made, count)
    return out + (_motions() + _spline() if whole_motions else [])


def groove_poses(mesh: SurfaceMesh, n: int, shallowest: float, deepest: float, seed: int = 0) -> Pose:
    """Poses of a button, turned anyhow, whose sphere is so deep in the rig's groove [m]; negative: so far off it."""
    random = np.random.default_rng(seed)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    normals = mesh.area_vectors / np.maximum(mesh.face_areas, 1e-300)[:, None]
    near = np.flatnonzero((np.abs(middles[:, 1]) < 12e-3) & (normals[:, 2] > 0.2))
    which = random.choice(near, n)
    place = middles[which] + rig.BUTTON_RADIUS * normals[which]
    wanted = rig.BUTTON_RADIUS - random.uniform(shallowest, deepest, n)
    for k in range(n):
        for _ in range(20):  # off the vertex that is nearest, until that is as far as wanted
            away = place[k] - mesh.vertices
            distance = np.linalg.norm(away, axis=1)
            i = int(np.argmin(distance))
            place[k] = mesh.vertices[i] + away[i] * (wanted[k] / distance[i])
    q = random.normal(size=(4, n))
    turn = Quaternion(*jnp.asarray(q / np.linalg.norm(q, axis=0)))
    return Pose(Vec3.from_array(jnp.asarray(place)), turn)


def _timed(query: Query, data: Any, poses: Pose) -> float:
    """Median time of a query in a compiled loop over the poses [s]."""
    n = poses.position.x.shape[0]
    arrays, fixed = eqx.partition(data, eqx.is_array)
    run = jax.jit(lambda a, p: jax.lax.map(lambda one: query(eqx.combine(a, fixed), one), p))
    return measure(lambda: run(arrays, poses), runs=7).median / n


def _in_a_batch(query: Query, data: Any, poses: Pose) -> float:
    """The same for a batch, each of its members [s]."""
    some = jax.tree.map(lambda x: x[:BATCH], poses)
    arrays, fixed = eqx.partition(data, eqx.is_array)
    run = jax.jit(lambda a, p: jax.vmap(lambda one: query(eqx.combine(a, fixed), one))(p))
    return measure(lambda: run(arrays, some), runs=7).median / some.position.x.shape[0]


def _contour(pair: Any, X: Pose) -> Any:
    return pair.contacts(X)


def _volume(mesh: Any, X: Pose) -> Any:
    patch = sphere_patch(mesh, X.position, jnp.asarray(rig.BUTTON_RADIUS))
    return jax.tree.map(jnp.asarray, patch)


def _queries(mesh: SurfaceMesh, count: int) -> list[Row]:
    deep, clear = groove_poses(mesh, count, 0.05e-3, 0.5e-3), groove_poses(mesh, count, -1e-3, -0.5e-3)
    lateral = lateral_of_groove(mesh, rig_region(mesh))
    button = icosphere(rig.BUTTON_RADIUS, BUTTON)
    pair = jax.jit(mesh_pair)(contact_mesh(mesh, lateral), contact_mesh(button))
    patch = patch_mesh(mesh, rig.BUTTON_RADIUS, lateral).prepared()
    sizes = f"{len(mesh.faces)} triangles"
    out = []
    for name, query, data, single, batch in (
        (f"mesh of {sizes} on {len(button.faces)}: contours and largest indentation", _contour, pair, 200.0, 130.0),
        (f"sphere on {sizes}: volume of the overlap", _volume, patch, 30.0, 30.0),
    ):
        for what, seconds, target in (
            ("touching", _timed(query, data, deep), single),
            (f"touching, batch of {BATCH}", _in_a_batch(query, data, deep), batch),
            ("clear", _timed(query, data, clear), 25.0),
        ):
            out.append(Row(TOPIC, f"{name}, {what}", 1e6 * seconds, "us", target, "at most"))
    for name, seconds in peers(mesh, button, deep, clear):
        out.append(Row(TOPIC, name, 1e6 * seconds, "us"))
    return out


def _growth(made: dict[str, SurfaceMesh], count: int) -> list[Row]:
    """From the coarsest to the finest of meshes."""
    button = contact_mesh(icosphere(rig.BUTTON_RADIUS, BUTTON))
    times: dict[str, list[float]] = {"contours": [], "volume": []}
    for mesh in made.values():
        poses = groove_poses(mesh, count, 0.05e-3, 0.5e-3)
        lateral = lateral_of_groove(mesh, rig_region(mesh))
        times["contours"].append(_timed(_contour, jax.jit(mesh_pair)(contact_mesh(mesh, lateral), button), poses))
        times["volume"].append(_timed(_volume, patch_mesh(mesh, rig.BUTTON_RADIUS, lateral).prepared(), poses))
    counts = [len(m.faces) for m in made.values()]
    return [
        Row(
            TOPIC,
            f"{name}: growth from {counts[0]} to {counts[-1]} triangles",
            found[-1] / found[0],
            "x",
            2.5,
            "at most",
            details={str(n): 1e6 * t for n, t in zip(counts, found, strict=True)},
        )
        for name, found in times.items()
    ]


def _motions() -> list[Row]:
    """Whole motions of case 1 at the longest step that stays near the converged motion."""
    out = []
    for name, wanted in MOTIONS.items():
        scene = pftwin.rig.case(1, contact=name)
        given = settle_first_frame(scene.unnamed())[0].answer
        paths = {n: np.asarray(_path(scene, n, given)().array()) for n in (100, 10, 5)}
        for n in (5, 10):
            rms = float(np.sqrt(np.mean(np.sum((paths[n] - paths[100]) ** 2, axis=-1))))
            if rms <= LEVEL or n == 10:
                break
        times = measure(_path(scene, n, given), runs=3)
        note = f"{10 / n:g} ms steps, {1e3 * rms:.3f} mm rms from steps of 0.1 ms"
        value = duration(scene) / times.median
        out.append(Row(TOPIC, f"whole motion, {name}", value, "x real time", wanted, note=note, details={"rms_m": rms}))
    return out


def _path(scene: Scene, n: int, start: Any) -> Callable[[], Any]:
    return compiled(lambda s, given: tracked_path(s, substeps=n, start=given), scene, start)


def _spline() -> list[Row]:
    """The spline's motion against the polynomial's."""
    smooth = [pftwin.rig.case(1, contact=name) for name in ("P5", "spline")]
    p5, spline = measure_in_turn(*(compiled(tracked_path, s) for s in smooth), runs=9)
    return [Row(TOPIC, "whole motion, spline against P5", spline.median / p5.median, "x", 2.0, "at most")]


__all__ = ["groove_poses", "rows"]
