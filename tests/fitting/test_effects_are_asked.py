"""Fits, treatments, outcomes and statuses ask effects what they are: what once went by a class or a field's name."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import polynomial, small_result, small_scene, vec

import fitting
import pftwin
from fitting.objective import Objective
from fitting.prediction.outcomes import Groove, groove_surface, outcomes
from pftwin.base.leaves import number
from pftwin.base.spatial import Vec3
from pftwin.dynamics.state import System
from pftwin.dynamics.status import Status, status_of_frame
from pftwin.geometry.contact.contact_mesh import contact_mesh
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.model.effects.mesh_contact import MeshContact
from pftwin.model.effects.tendon import StrandGroup, ToeTendon
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene


def with_toe() -> Scene:
    scene = small_scene(5)
    old = scene.effect("quadriceps")
    toe = ToeTendon(
        number(175.0), number(0.139), number(0.05), number(1.5), old.insertion, old.origin, "femur", name="quadriceps"
    )
    return scene.with_effect(toe)


def with_mesh(surface: bool = True) -> Scene:
    """A ball of 20 mm on a ball of 30 mm, both meshes."""
    femur, button = contact_mesh(icosphere(0.030, 4)), contact_mesh(icosphere(0.020, 3))
    law = small_scene(5).effect("contact").law
    stand_in = polynomial({(0, 2): 20.0, (2, 0): -15.0}) if surface else None
    return small_scene(5).with_effect(MeshContact(femur, button, law, vec(0.002, 0, 0.001), stand_in))


def test_k1_is_the_quadriceps_whatever_its_law() -> None:
    free = fitting.free_parameters(with_toe(), ("K1", "L1", "K2", "L2"))
    np.testing.assert_allclose(free.nominal, [175.0, 0.139, 629.0, 0.0714])
    assert [p.place.owner for p in free.items] == ["quadriceps", "quadriceps", "patellar_tendon", "patellar_tendon"]


def test_a_group_keeps_its_number_and_says_that_it_is_one() -> None:
    scene = small_scene(5)
    ends = [Vec3(*(jnp.stack([a, a + 0.001]) for a in (v.x, v.y, v.z))) for v in (vec(0.02, 0, 0), vec(0.2, 0, 0.03))]
    k, rest, toe, c = (number([x, 1.1 * x]) for x in (5000.0, 0.14, 0.06, 0.0))
    strands = StrandGroup(k, rest, toe, c, *ends, body="femur", name="quadriceps")
    with pytest.raises(
        pftwin.InputError, match=r"'K1' is that of 'quadriceps', a group of 2.*quadriceps.stiffness\[0\]"
    ):
        fitting.free_parameters(scene.with_effect(strands), ("K1",))
    assert float(scene.with_effect(strands).get("K2")) == 629.0


def test_the_force_of_a_toe_tendon_is_its_own_law() -> None:
    scene = with_toe()
    for wanted in (1.0, 25.0):  # within the toe, and beyond
        changed = scene.set("L1.force", wanted)
        tendon = changed.effect("quadriceps")
        length = np.linalg.norm(np.asarray((tendon.origin - changed.start.apply(tendon.insertion)).array()))
        stretch, end = length - float(tendon.slack_length), 0.05 * float(tendon.slack_length)
        tension = 175.0 * (stretch**2 / (2 * end) if stretch < end else stretch - end / 2)
        assert tension == pytest.approx(wanted, rel=1e-9)
        assert float(changed.get("L1.force")) == pytest.approx(wanted, rel=1e-9)


def test_a_toe_region_tendon_can_be_treated() -> None:
    longer = fitting.treatments.quadriceps_lengthening(with_toe(), 0.004)
    assert float(longer.get("L1")) == pytest.approx(0.143)


def test_a_muscle_of_known_tension_is_refused_by_what_it_is() -> None:
    old = small_scene(5).effect("quadriceps")
    shaped = ((old.origin, (1, 1)), (old.insertion, (1,)))
    lines = [Vec3(*(jnp.reshape(a, shape) for a in (v.x, v.y, v.z))) for v, shape in shaped]
    muscle = PrescribedTension(number([[20.0]]), *lines, 0.0, 0.01, "femur", name="quadriceps")
    with pytest.raises(pftwin.InputError, match="'quadriceps' pulls with a prescribed tension"):
        fitting.treatments.quadriceps_lengthening(small_scene(5).with_effect(muscle), 0.004)


def test_all_that_was_measured_holds_the_force_of_a_mesh() -> None:
    scene, n = with_mesh(), 5
    measured = Measured(scene.motion.times, np.ones((n, 3)), contact_force=np.linspace(3.0, 4.0, n))
    assert Objective.of(scene, measured, use="all").channels == ("position", "contact")
    assert "contact" in fitting.channels_of(scene)


def test_the_groove_of_a_mesh_is_its_stand_in() -> None:
    Groove.of(with_mesh())
    with pytest.raises(pftwin.InputError, match="meshes of 'contact' do not tell where the groove is"):
        groove_surface(with_mesh(surface=False))
    meshes = dataclasses.replace(small_result(), scene=with_mesh(surface=False), surface=None)
    with pytest.raises(pftwin.InputError, match="meshes of 'contact' do not tell where the groove is"):
        outcomes(meshes)


def test_a_treatment_of_the_fitted_surface_refuses_a_mesh() -> None:
    with pytest.raises(pftwin.InputError, match="'contact' is a contact with the femur's mesh"):
        fitting.treatments.femoral_component_translation(with_mesh(), medialisation=0.002)


def test_the_button_of_a_mesh_can_be_moved() -> None:
    moved = fitting.treatments.button_position(with_mesh(), medialisation=0.003)
    assert float(moved.get("contact.origin.y")) == pytest.approx(-0.003)
    assert float(moved.get("contact.origin.x")) == pytest.approx(0.002)


@eqx.filter_jit
def flags_at(scene: Scene, velocity: Vec3) -> jax.Array:
    """Of a frame with a patella at its start that moves, after a step of 1 ms."""
    state = System.of(scene).at_rest(scene.center_of_mass_pose(), (None,) * len(scene.effects))
    state = eqx.tree_at(lambda s: s.velocity, state, velocity)
    nothing = {name: jnp.asarray(0.0) for name in ("force", "indentation_medial", "indentation_lateral")}
    reports = {e.name: dict(nothing) for e in scene.effects}
    return status_of_frame(scene, reports, state, jnp.asarray(1e-3), None)


@pytest.mark.parametrize(("speed", "too_long"), [(4.5, False), (5.1, True)])
def test_a_step_may_not_leap_over_a_mesh_button(speed: float, too_long: bool) -> None:
    scene = with_mesh()  # a quarter of 20 mm in a step of 1 ms is 5 m/s
    found = Status(int(flags_at(scene, vec(speed, 0, 0))))
    assert (Status.STEP_TOO_LONG in found) == too_long


def test_every_parameter_of_the_rig_says_its_unit() -> None:
    for contact in ("P5", "spline"):
        scene = pftwin.rig.case(1, contact=contact)
        units = {f"{e.name}.{field}": q.unit for e in scene.effects for field, q in e.quantities().items()}
        assert units["quadriceps.stiffness"] == units["patellar_tendon.stiffness"] == "N/m"
        assert units["contact.surface.half_size.0"] == units["contact.radius"] == "m"
        assert units["contact.law.restitution"] == ""
        assert units["damping.rotational"] == "N m s/rad"


def test_bounds_hold_for_members_of_nested_values() -> None:
    scene = small_scene(5)
    for name, value, words in (
        ("contact.law.restitution", 1.2, "found 1.2.*at most 1"),
        ("contact.law.hertz_exponent", 0.9, "found 0.9.*at least 1"),
        ("patella.inertia.y", -1e-5, "found -1e-05.*positive"),
        ("quadriceps.damping", -0.5, "found -0.5.*zero or a positive"),
    ):
        with pytest.raises(pftwin.InputError, match=words):
            pftwin.simulate(_with(scene, name, value))


def _with(scene: Scene, name: str, value: float) -> Scene:
    if name.endswith("hertz_exponent"):  # a plain number: structure of the program, and no array
        contact = scene.effect("contact")
        return scene.with_effect(
            dataclasses.replace(contact, law=dataclasses.replace(contact.law, hertz_exponent=value))
        )
    return scene.set(name, value)
