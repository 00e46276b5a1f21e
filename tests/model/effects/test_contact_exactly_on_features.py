"""Two meshes that meet exactly on a vertex, on an edge, or just touch: forces right, derivatives finite.

A ball of triangles with a corner (or a triangle's middle) pointing straight down is put over a plate's vertex, edges
and face, so that rays, nearest points and crossings fall exactly on features, to the last bit where that can be.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_meshes import plate
from scenes import J, about, vec
from scipy.spatial.transform import Rotation as Turn

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.base import Effect, Ground, Instant, Patella
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.elastic_foundation import ElasticFoundation
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.motion import Frame

RADIUS, SIDE, DEPTH = 0.0234375, 0.0078125, 0.000244140625  # [m] sums of powers of two: nothing is rounded
SPOTS = {"vertex": (0.0, 0.0), "edge": (SIDE / 2, 0.0), "diagonal": (SIDE / 2, SIDE / 2), "face": (SIDE / 2, SIDE / 4)}


PLATE = plate(12, 6 * SIDE)


def ball(down: str) -> SurfaceMesh:
    """A ball whose first corner, or first triangle's middle, is straight below its centre."""
    mesh = icosphere(RADIUS, 14)
    way = mesh.vertices[0] if down == "corner" else mesh.vertices[mesh.faces[0]].mean(axis=0)
    turn = Turn.align_vectors([[0.0, 0.0, -1.0]], [way / np.linalg.norm(way)])[0]
    vertices = turn.apply(mesh.vertices)
    if down == "corner":
        vertices[0] = [0.0, 0.0, -RADIUS]
    return SurfaceMesh(vertices, mesh.faces, "ball")


@pytest.fixture(scope="module", params=["contours", "layers"])
def effect(request) -> Effect:
    if request.param == "contours":
        sides = contact_mesh(PLATE), contact_mesh(ball("corner"))
        return about(MeshContact(*sides, Hertz(J(2e8)), vec(0, 0, 0)), vec(0, 0, 0))
    layer = checked_layer(50e6, 0.45, 5e-3)
    sides = pressed_surface(PLATE), pressing_surface(ball("middle"))
    return ElasticFoundation(*sides, LinearFoundation(layer, layer), vec(0, 0, 0))


@eqx.filter_jit
def looked(effect: Effect, d):
    """Force, moment and energy at a displacement and turn d, and their derivatives in both modes."""

    def look(d):
        turn = Quaternion.from_rotation_vector(Vec3(*d[3:]))
        now = Instant(Patella.at_rest(Vec3(*d[:3]), turn), Ground(), Frame.world(), J(0.0), J(0.0))
        load = effect.load(now, effect.remember(now))[0]
        wrench = load.total()
        return jnp.concatenate([wrench.force.array(), 1e2 * wrench.moment.array(), 1e3 * load.energy[None]])

    return look(d), jax.jacfwd(look)(d), jax.jacrev(look)(d)


@pytest.mark.parametrize("spot", SPOTS)
@pytest.mark.slow
def test_derivatives_are_finite_and_agree_where_features_meet(effect, spot):
    d = J([*SPOTS[spot], RADIUS - DEPTH, 0.0, 0.0, 0.0])
    value, forward, reverse = looked(effect, d)
    assert float(value[2]) > 1
    assert np.abs(value[:2]).max() < 0.02 * float(value[2])
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * float(np.abs(forward).max()))
    # The energy's slope is the force, on features as beside them (the paper's law has no moment to go with it).
    assert float(1e-3 * forward[6, 2]) == pytest.approx(-float(value[2]), rel=1e-6)


@pytest.mark.parametrize("spot", SPOTS)
@pytest.mark.parametrize("gap", [0.0, 1e-300, 1e-15, 1e-3])
@pytest.mark.slow
def test_just_touching_or_clear_there_is_next_to_no_force_and_every_derivative_is_finite(effect, spot, gap):
    value, forward, reverse = looked(effect, J([*SPOTS[spot], RADIUS + gap, 0.0, 0.0, 0.0]))
    assert np.abs(value).max() < 1e-3
    assert np.isfinite(forward).all()
    assert np.isfinite(reverse).all()
