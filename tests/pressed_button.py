"""A button on a flat plate, with layers, tendons that pull it down and one that a tibia moves: small meshes."""

from __future__ import annotations

import numpy as np
from height_meshes import plate
from scenes import J, gravity, knee_motion, tendon, vec

from pftwin.base.spatial import Pose, Quaternion
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.model.scene import PatellaBody, Scene

DOME, REACH = 0.025, 0.006  # the dome's radius of curvature and half its width [m]
MASS, HEAVY = 0.12, 2.0
ARM = 0.004  # of the tendons' insertions, sideways


def disc(curvature: float, rings: int = 9, spokes: int = 24) -> SurfaceMesh:
    """A round button of 408 triangles that looks down, its apex at the origin; curvature 0 is flat [1/m]."""
    r = REACH * np.arange(1, rings + 1) / rings
    turn = 2 * np.pi * np.arange(spokes) / spokes
    x, y = (np.concatenate([[0], np.outer(r, f(turn)).ravel()]) for f in (np.cos, np.sin))
    square = x**2 + y**2
    z = curvature * square / (1 + np.sqrt(1 - curvature**2 * square))
    k = 1 + np.arange(rings * spokes).reshape(rings, spokes)
    on = np.roll(k, -1, axis=1)
    middle = np.stack([0 * k[0], on[0], k[0]], axis=1)
    inner, outer, inner_on, outer_on = (q.ravel() for q in (k[:-1], k[1:], on[:-1], on[1:]))
    bands = [np.stack([inner, outer_on, outer], 1), np.stack([inner, inner_on, outer_on], 1)]
    return SurfaceMesh(np.stack([x, y, z], axis=1), np.concatenate([middle, *bands]), "button")


def foundation(mesh: SurfaceMesh, modulus: float = 20e6, damping_time: float = 2e-3, **more) -> ElasticFoundation:
    """Two layers of 3 mm between the button and the plate."""
    layer = checked_layer(modulus, 0.4, 3e-3)
    surfaces = pressed_surface(plate(8, 0.02)), pressing_surface(mesh)
    return ElasticFoundation(*surfaces, LinearFoundation(layer, layer), vec(0, 0, 0), J(damping_time), **more)


def pressed(mesh: SurfaceMesh, height: float = 0.0, n_frames: int = 31, **more) -> Scene:
    """Two tendons pull down on either side, a weak one towards a tibia that bends."""
    down = [tendon(2e3, 0.05, 2.0, (s * ARM, 0, 0.006), (2 * s * ARM, 0, -0.06), "ground", n) for s, n in _SIDES]
    across = tendon(200.0, 0.03, 1.0, (0, 0, 0.008), (0.0, 0.03, 0.02), "tibia", "across")
    drag = LinearDamping(J(2.0), J(1e-3), body="ground")
    effects = (gravity(MASS), *down, across, drag, foundation(mesh, **more))
    body = PatellaBody(J(MASS), vec(3e-5, 3e-5, 4e-5), vec(0, 0, 0.004))
    return Scene(body, effects, knee_motion(n_frames), Pose(vec(0, 0, height), Quaternion.identity()), "button")


_SIDES = ((-1, "one"), (1, "other"))
