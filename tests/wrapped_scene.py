"""The small knee with lines that run over obstacles on each of its bones."""

from __future__ import annotations

from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from small_scene import small_scene, vec

import pftwin
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.model.effects.tendon import StrandGroup, Tendon
from pftwin.model.scene import Scene

# Radii [m]; axes of all cylinders are medial-lateral.
ROUND = {"quadriceps": ("femur", 0.02), "patellar_tendon": ("tibia", 0.01), "brace": ("patella", 0.006)}
RADII, BESIDE = np.array([0.02, 0.018, 0.022]), np.array([0.002, -0.024, 0.02])  # of the ellipsoid, and its centre


def wrapped_scene() -> Scene:
    """Quadriceps, patellar tendon and a brace over cylinders, three strands over an ellipsoid on the femur."""
    scene, y = small_scene(), vec(0.0, 1.0, 0.0)
    brace = Tendon(
        number(20.0), number(0.06), number(0.1), vec(-0.015, 0.004, 0), vec(-0.06, 0.02, 0.03), "femur", name="brace"
    )
    centers = {"quadriceps": (0.1, 0.0, 0.0229), "patellar_tendon": (-0.05, 0.0, 0.036), "brace": (-0.036, 0.0, -0.005)}
    for line in (scene.effect("quadriceps"), scene.effect("patellar_tendon"), brace):
        bone, radius = ROUND[line.name]
        obstacle = Cylinder(vec(*centers[line.name]), bone, number(radius), y)
        scene = scene.with_effect(eqx.tree_at(lambda t: t.wrap, line, obstacle, is_leaf=lambda x: x is None))
    along, one = np.array([-0.004, 0.0, 0.004]), jnp.ones(3)
    insertion, origin = np.zeros((2, 3, 3))
    insertion[:, 0], insertion[:, 1], insertion[:, 2] = along, -0.02, -0.006
    origin[:, 0], origin[:, 1], origin[:, 2] = along, -0.044, 0.002
    beside = Ellipsoid(vector(BESIDE), "femur", vector(RADII), Quaternion.identity())
    strands = StrandGroup(
        100.0 * one,
        0.05 * one,
        0.06 * one,
        0.003 * one,
        vector(insertion),
        vector(origin),
        "femur",
        wrap=beside,
        name="mpfl",
    )
    return scene.with_effect(strands)


@cache
def wrapped_result() -> pftwin.Result:
    return pftwin.simulate(wrapped_scene(), dt=0.01)
