"""Friction of a sphere on a mesh: along a V-shaped groove and down a plate, as in any textbook."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, RADIUS, G, J, look, march, record, state_at, system, vec

from pftwin.geometry.contact.patch_mesh import mesh_facets, patch_mesh
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.contact_law import HuntCrossley
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact, RoughMeshSphereContact
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact, RoughMeshVolumeContact

MU, CREEP, BLOCK = 0.2, 1e-3, (1e9, 1e9, 1e9)
LAW = HuntCrossley(J(2e8), J(1.0))


def vee(flank: float) -> tuple[SurfaceMesh, Any]:
    """Two flanks along x that rise by an angle on either side of y = 0, and which triangles are lateral."""
    x, y = np.array([-0.5, 0.5]), np.array([-0.05, 0.0, 0.05])
    vertices = np.array([[a, b, abs(b) * np.tan(flank)] for a in x for b in y])
    faces = np.array([[0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2]])
    lateral = np.array([False, False, True, True]) if flank else None
    return SurfaceMesh(vertices, faces), lateral


def rough(kind: str, flank: float = 0.0):
    mesh, lateral = vee(flank)
    sphere = LAW, vec(0, 0, 0), J(RADIUS)
    if kind == "nearest":
        plain: Any = MeshSphereContact(mesh_facets(mesh, lateral), *sphere)
    else:
        plain = MeshVolumeContact(patch_mesh(mesh, RADIUS, lateral), *sphere, J(RADIUS))
    return plain.with_friction(Friction(J(MU), J(CREEP)))


def test_every_contact_becomes_its_rough_kind_and_back():
    for kind, wanted in (("nearest", RoughMeshSphereContact), ("volume", RoughMeshVolumeContact)):
        made = rough(kind)
        assert type(made) is wanted
        assert type(made.alone()) is wanted.frictionless  # type: ignore[attr-defined]
        again = made.with_friction(Friction(J(0.5), J(CREEP)))
        assert type(again) is wanted
        assert float(again.friction.coefficient) == 0.5  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["nearest", "volume"])
@pytest.mark.parametrize("flank", [0.0, 25.0])
@pytest.mark.slow
def test_along_a_groove_it_slows_by_mu_g_over_the_flanks_cosine(kind, flank):
    """Each flank bears m g / (2 cos); a plate is a groove without flanks."""
    angle = np.radians(flank)
    sys = system(Gravity(J(MASS), vec(0, 0, -G)), rough(kind, angle), inertia=BLOCK)
    height = RADIUS / np.cos(angle) - (MASS * G / 2 / np.cos(angle) / 2e8) ** (2 / 3) / np.cos(angle)
    before = march(sys, state_at(sys, (-0.05, 0, height), (0.3, 0, 0)), 0.02, 40)
    after = march(sys, before, 0.05, 100)
    slower = float(before.velocity.x - after.velocity.x) / 0.05
    assert slower == pytest.approx(MU * G / np.cos(angle), rel=0.01)
    seen = sys.effects[1].observe(look(tuple(float(v) for v in after.position.array()),
                                       tuple(float(v) for v in after.velocity.array())), after.memories[1])  # fmt: skip
    sides = ("medial", "lateral")
    friction = sum(float(seen[f"friction_{s}"]) for s in sides)
    assert friction == pytest.approx(MU * sum(float(seen[f"force_{s}"]) for s in sides), rel=1e-3)
    assert float(seen["force_x"]) == pytest.approx(-friction, rel=1e-3)
    assert set(seen) == set(sys.effects[1].observables)


@pytest.mark.parametrize("kind", ["nearest", "volume"])
def test_it_stops_and_stays_at_steps_of_five_milliseconds(kind):
    sys = system(Gravity(J(MASS), vec(0, 0, -G)), rough(kind), inertia=BLOCK)
    start = state_at(sys, (0, 0, RADIUS - (MASS * G / 2e8) ** (2 / 3)), (0.05, 0.02, 0))
    states, _ = record(sys, start, J(5e-3), 60)
    speed = np.hypot(np.asarray(states.velocity.x), np.asarray(states.velocity.y))
    assert np.all(np.diff(speed) <= 1e-12)
    assert speed[-1] < 1e-6
    assert jnp.isfinite(states.position.z).all()
