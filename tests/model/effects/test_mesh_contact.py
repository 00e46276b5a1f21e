"""The paper's contact between two meshes, as an effect."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from height_meshes import plate
from scenes import J, about

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.observe import observe
from pftwin.dynamics.status import Status
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.model.effects.base import Ground, Instant, Patella
from pftwin.model.effects.contact_law import Flores, Hertz
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.motion import Frame
from pftwin.rig import case

RADIUS = 0.025


def vec(x: float, y: float, z: float) -> Vec3:
    return Vec3(J(float(x)), J(float(y)), J(float(z)))


def instant(position: Vec3, velocity: Vec3, spin: Vec3) -> Instant:
    turn = Quaternion.from_rotation_vector(vec(0.1, -0.2, 0.3))
    return Instant(Patella(position, turn.rotation(), velocity, spin), Ground(), Frame.world(), J(0.0), J(0.0))


@pytest.fixture(scope="module")
def on_a_plate() -> MeshContact:
    law = Flores(J(2e8), J(0.5))
    made = MeshContact(contact_mesh(plate()), contact_mesh(icosphere(RADIUS, 40)), law, vec(1e-3, 2e-3, 5e-3))
    return about(made, vec(1e-3, 1e-3, -7e-3))


@eqx.filter_jit
def loaded(effect: MeshContact, now: Instant, memory):
    return effect.load(now, memory), effect.report(now, memory)


@pytest.mark.slow
def test_force_moment_energy_and_rate_on_a_plate(on_a_plate):
    depth, arm = 0.3e-3, on_a_plate.origin
    turn = Quaternion.from_rotation_vector(vec(0.1, -0.2, 0.3))
    position = vec(0.0, 0.0, RADIUS - depth) - turn.rotate(arm)
    velocity, spin = vec(0.01, 0.02, -0.05), vec(0.3, -0.2, 0.1)
    (load, speeds), (report, energy) = loaded(on_a_plate, instant(position, velocity, spin), (J(0.0),))
    (term,) = load.stiff
    found = float(report["indentation_medial"])
    np.testing.assert_allclose(found, depth, atol=1e-5)
    point = vec(0.0, 0.0, 0.0) - position
    body = turn.rotate(spin)
    rate = -float((velocity + body.cross(point)).z)
    np.testing.assert_allclose(term.rate, rate, rtol=2e-2)
    np.testing.assert_allclose(speeds[0], term.rate)
    law = on_a_plate.law.force(J(found), term.rate, term.rate)
    np.testing.assert_allclose(term.force, law.total, rtol=1e-12)
    np.testing.assert_allclose(energy, 0.4 * 2e8 * found**2.5, rtol=1e-12)
    np.testing.assert_allclose(load.energy, energy)
    np.testing.assert_allclose(term.direction.array(), [0, 0, 1], atol=1e-6)
    moment = turn.unrotate(point.cross(vec(0.0, 0.0, 1.0)))
    np.testing.assert_allclose(term.moment.array(), moment.array(), atol=1e-4)
    np.testing.assert_allclose(report["force_z"], term.force, rtol=1e-9)
    assert not any(float(report[name]) for name in ("at_rim", "overflow", "too_deep", "merged"))


@pytest.mark.slow
def test_without_contact_there_is_no_force_and_no_approach_speed(on_a_plate):
    now = instant(vec(0.0, 0.0, RADIUS + 0.02), vec(0.0, 0.0, -1.0), vec(0.0, 0.0, 0.0))
    (load, speeds), (report, energy) = loaded(on_a_plate, now, (J(0.3),))
    assert float(load.stiff[0].force) == 0
    assert float(speeds[0]) == 0
    assert float(energy) == 0
    assert float(report["force"]) == 0
    assert np.isnan(report["indentation_medial"])
    assert float(report["force_medial"]) == 0

    def energy_at(z):
        return on_a_plate.load(eqx.tree_at(lambda i: i.patella.position.z, now, z), (J(0.0),))[0].energy

    assert float(jax.jit(jax.grad(energy_at))(J(RADIUS + 0.02))) == 0


def test_it_takes_no_loads_before_it_is_made_ready():
    made = MeshContact(contact_mesh(plate(4)), contact_mesh(icosphere(RADIUS, 4)), Hertz(J(1e8)), vec(0, 0, 0))
    with pytest.raises(TypeError, match="call `recentred` first"):
        made.load(instant(vec(0, 0, 1), vec(0, 0, 0), vec(0, 0, 0)), None)


@pytest.fixture(scope="module")
def cut():
    """The first 0.6 s of case 1 on the coarse meshes, and on the spline."""
    scenes = (case(1, "FM"), case(1, "spline"))
    return [eqx.tree_at(lambda s: s.motion, x, replace(x.motion, n_frames=60)) for x in scenes]


@pytest.mark.slow
def test_the_rig_on_fine_meshes_moves_as_on_the_spline(cut):
    @eqx.filter_jit
    def run(scene):
        start = starting_equilibrium(scene)
        path = frame_states(scene, substeps=10, start=start)
        return observe(scene, path)

    on_mesh, smooth = (run(s) for s in cut)
    apart = np.linalg.norm((on_mesh.center - smooth.center).array(), axis=1)
    # The deviations of the button and the implant are 0.006 mm each, the spline's 0.006 mm rms.
    assert apart.max() < 0.1e-3
    assert apart.max() > 1e-6
    clean = int(Status.START_NOT_IN_EQUILIBRIUM)
    assert not (np.asarray(on_mesh.status) & ~clean).any()
    assert (np.asarray(on_mesh.effects["contact"]["force"]) > 0).all()
