"""A small knee for tests of results: a button in a parabolic groove, two tendons, weight, and a bending tibia."""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.base.leaves import number, vector
from pftwin.base.rotations import tibiofemoral_orientation
from pftwin.base.spatial import Pose, Quaternion, Rotation, Vec3
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.charts import PlaneChart
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.effects.tendon import StrandGroup, Tendon
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene

HALF_U, HALF_V = 0.030, 0.020
GROOVE_AT = 0.001  # lateral place of the groove's bottom [m]


def vec(*values: float) -> Vec3:
    return Vec3(*(number(v) for v in values))


def polynomial(heights: dict[tuple[int, int], float], degree: int = 2) -> PolynomialPatch:
    """A patch over a plane that faces halfway between anterior and distal: height = sum of c_ij u^i v^j."""
    angle = np.radians(40)
    z = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    y = np.array([0.0, 1.0, 0.0])
    axes = Rotation.from_array(jnp.asarray(np.stack([np.cross(y, z), y, z], axis=1)))
    c = jnp.asarray([heights.get((i, j), 0.0) * HALF_U**i * HALF_V**j for i, j in exponents(degree)])
    chart = PlaneChart(Vec3.from_array(jnp.asarray(0.026 * z)), axes)
    nought = number(0.0)
    return PolynomialPatch(chart, c, (nought, nought), (number(HALF_U), number(HALF_V)), degree)


def groove() -> PolynomialPatch:
    """A saddle: convex along the groove (radius 26 mm), concave across (15 mm: less than the button's 22 mm)."""
    k = 1 / (2 * 0.015)
    return polynomial({(2, 0): -1 / (2 * 0.026), (0, 2): k, (0, 1): -2 * k * GROOVE_AT, (0, 0): k * GROOVE_AT**2})


def knee_flexion(times: np.ndarray) -> np.ndarray:
    return np.radians(45 + 10 * np.sin(2 * np.pi * times / 0.8))


def small_scene(n_frames: int = 41) -> Scene:
    times = 0.01 * np.arange(n_frames)
    q = tibiofemoral_orientation(knee_flexion(times), np.full(n_frames, 0.05), np.full(n_frames, -0.03))
    tibia = PoseSeries(times, np.zeros((n_frames, 3)), np.stack([q.w, q.x, q.y, q.z], axis=1))
    k1, l1, k2, l2 = (number(x) for x in (156.0, 0.1432, 629.0, 0.0714))
    effects = (
        Gravity(number(0.12), vec(0, 0, -9.81)),
        Tendon(k1, l1, 0.01 * k1, vec(0.02, 0, -0.008), vec(0.22, 0.006, 0.035), "femur", name="quadriceps"),
        Tendon(k2, l2, 0.01 * k2, vec(-0.02, 0, -0.008), vec(-0.07, 0.004, 0.045), "tibia", name="patellar_tendon"),
        SphereContact(groove(), Flores(number(2e8), number(0.6)), vec(0, 0, 0), number(0.022)),
    )
    body = PatellaBody(number(0.12), vec(3e-5, 3e-5, 4e-5), vec(0.001, 0, 0.004))
    start = Pose(vec(-0.005, 0.001, 0.05), Quaternion.identity())
    return Scene(body, effects, KneeMotion.from_poses(None, tibia), start, "small knee")


def hanging_scene(n_frames: int = 41) -> Scene:
    """Held by strands from the patella's corners in the place of the groove: its programs compile in less time.

    From each of four corners they pull outward along both axes of the patella's plane, up and down.
    """
    scene = small_scene(n_frames).without("contact")
    corners = np.array([(x, y, 0.0) for x in (-0.015, 0.015) for y in (-0.015, 0.015)])
    insertion, ways = np.repeat(corners, 4, axis=0), np.tile([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)], (4, 1))
    away = 0.04 * np.where(ways[:, 2:] == 0, ways * np.sign(insertion), ways)
    origin = np.array([-0.005, 0.001, 0.05]) + insertion + away
    stiffness, slack, toe, damping = (number(np.full(len(away), v)) for v in (15.0, 0.03, 0.06, 0.003))
    return scene.with_effect(
        StrandGroup(stiffness, slack, toe, damping, vector(insertion), vector(origin), "femur", name="strands")
    )


@cache
def small_result() -> pftwin.Result:
    return pftwin.simulate(small_scene())
