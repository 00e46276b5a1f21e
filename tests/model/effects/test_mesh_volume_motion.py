"""A sphere on a mesh by the volume of their overlap: what moves on it, and what it stands for."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from height_meshes import grid
from mesh_volumes import K, contact
from scenes import RADIUS, J, energies, gravity, knee, record, run, settled, state_at, system, trochlea, vec

from pftwin.base.spatial import Vec3
from pftwin.dynamics.observe import observe
from pftwin.dynamics.status import Status
from pftwin.geometry.bvh.wide import BallListLengths
from pftwin.geometry.contact.overlap import beside_groove, effective_radius
from pftwin.geometry.contact.patch_mesh import lateral_of_groove, patch_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.implant import rig_region
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact
from pftwin.model.scene import Scene
from pftwin.rig.cases import case
from pftwin.rig.contacts import implant_mesh


@pytest.mark.slow
def test_energy_is_conserved_by_a_sphere_that_bounces_on_a_ball_of_triangles():
    """Elastic law, small steps: there is no heat, and what the steps take tends to zero with them."""
    taken = []
    ball = icosphere(0.03, 16)
    sys = system(gravity(), contact(ball, effective=0.0127))
    start = state_at(sys, (0.0003, 0.0002, float(ball.vertices[:, 2].max()) + RADIUS + 2e-4))
    for count in (400, 1600):
        states, ledger = record(sys, start, J(0.016 / count), count)
        total, own = energies(sys, states), ledger.done - jax.vmap(sys.kinetic_energy)(states)
        assert np.abs(ledger.heat).max() == 0
        assert np.abs(total - total[0] + own - own[0]).max() < 0.01 * 0.12 * 9.81 * 2e-4
        taken.append(float(np.abs(own).max()))
    assert float(states.velocity.z.max()) > 0.01  # it has bounced
    assert taken[1] < 0.35 * taken[0]
    assert taken[1] < 0.15 * 0.12 * 9.81 * 2e-4


@pytest.fixture(scope="module")
def small_mesh() -> SurfaceMesh:
    """The small knee's trochlea, as far as its patch goes."""
    patch = trochlea()
    half = tuple(float(h) for h in patch.half_size)
    flat = grid(lambda u, v: np.asarray(patch.height(J(u), J(v))), 91, half)
    place = patch.chart.from_frame(Vec3.from_array(J(flat.vertices)))
    return SurfaceMesh(np.asarray(place.array()), flat.faces, "small trochlea")


def small_knee(mesh: SurfaceMesh, law) -> Scene:
    n = len(mesh.faces) // 2
    across = np.arange(2 * n) % n % 90 >= 45
    made = patch_mesh(mesh, RADIUS, across)
    return knee(6).with_effect(MeshVolumeContact(made, law, vec(0, 0, 0), J(RADIUS), J(0.0125)))


@pytest.mark.slow
def test_a_knee_settles_and_moves_on_a_mesh_as_on_its_patch_and_a_list_too_short_is_in_its_status(small_mesh):
    law = Flores(J(K), J(0.6))
    patch, scene = knee(6, law), small_knee(small_mesh, law)
    smooth, start = settled(patch), settled(scene)
    assert bool(start.converged())
    assert float((start.pose.position - smooth.pose.position).norm()) < 0.06e-3
    ideal, _ = run(patch, smooth)
    path, seen = run(scene, start)
    assert (np.asarray(seen.status) == 0).all()
    way = np.linalg.norm((path.states.position - ideal.states.position).array(), axis=1)
    assert way.max() < 0.08e-3
    assert float(np.ptp(np.asarray(ideal.states.position.array()), axis=0).max()) > 0.2e-3
    effect = scene.effect("contact")
    short = scene.with_effect(replace(effect, mesh=replace(effect.mesh, room=BallListLengths(2, 3))))
    flags = np.asarray(eqx.filter_jit(lambda s, p: observe(s, p))(short, path).status)
    assert (flags & int(Status.SEARCH_OVERFLOW)).all()
    assert "ran out of room" in Status(int(flags[0])).describe()


def test_the_effective_radius_of_a_ball_is_that_of_two_spheres():
    """1 / r = 1 / R + 1 / 30 mm."""
    ball = icosphere(0.03, 40)
    found = effective_radius(ball, patch_mesh(ball, 0.025), 0.025)
    np.testing.assert_allclose(found, 1 / (1 / 0.025 + 1 / 0.03), rtol=0.02)


@pytest.mark.slow
def test_the_rig_moves_on_its_mesh_as_on_the_smooth_implant():
    """Case 1, the first 2 s: within 0.15 mm everywhere."""
    from pftwin.dynamics.simulate import simulate
    from pftwin.geometry.patch.implant import rig_implant
    from pftwin.model.effects.sphere_contact import SphereContact

    scene, mesh = case(1), implant_mesh()
    old, region = scene.effect("contact"), rig_region(mesh)
    made = patch_mesh(mesh, 0.025, lateral_of_groove(mesh, region))
    radius = effective_radius(mesh, made, 0.025, beside_groove(mesh, region, 0.0125))
    on_mesh = scene.with_effect(MeshVolumeContact(made, old.law, old.center, old.radius, J(radius)))
    smooth = scene.with_effect(SphereContact(rig_implant(), old.law, old.center, old.radius))
    a, b = simulate(on_mesh), simulate(smooth)
    assert a.status == Status.OK
    assert np.linalg.norm(a.center - b.center, axis=1).max() < 0.15e-3
