"""The plant's own mechanics, against closed forms and its own energy; `test_plant_twin` compares it with the twin."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pftwin.geometry.patch.implant import rig_implant
from pftwin.rig import geometry as rig
from tests.verification.rig_plant import mechanics
from tests.verification.rig_plant.mechanics import BUTTON, FRICTION, STICTION_SPEED, Plant, built_springs, plant_of
from tests.verification.rig_plant.plant_contact import ImplantContact
from tests.verification.rig_plant.plant_parts import Frame, GuidedBones, Spring, cross, matrix

FILES = [Path(mechanics.__file__).with_name(f"{name}.py") for name in ("mechanics", "plant_contact", "plant_parts")]
NUMBERS = {
    "pftwin.rig.geometry",
    "pftwin.geometry.patch.implant",
    "tests.verification.rig_plant.hand",
}  # the rig's, the implant's, the hand's
STILL, NOTHING = np.zeros(3), np.array([1.0, 0, 0, 0])
R = 0.03  # of a cylinder [m]


@pytest.fixture(scope="module")
def plant():
    return plant_of(1)[0]


@pytest.fixture(scope="module")
def rest(plant):
    return plant.resting(0.0)


def still_bones():
    times = np.linspace(0.0, 1.0, 5)
    pose = np.zeros((5, 3)), np.tile(NOTHING, (5, 1))
    return GuidedBones(times, pose, pose)


def cylinder() -> ImplantContact:
    """An implant about the femur's y axis without groove, ridges and notch."""
    shape = SimpleNamespace(**vars(plant_of(1)[0].contact.shape))
    shape.trochlear_radius = shape.flange_radius = shape.distal_radius = R
    shape.sulcus_angle = shape.sulcus_angle_proximal = np.pi
    shape.lateral_steepness = shape.outer_slope = shape.notch_depth = 0
    return ImplantContact(shape, rig.BUTTON_RADIUS)


def slack(spring: Spring) -> Spring:
    return spring._replace(slack_length=10.0)


def in_the_air(**fields) -> Plant:
    """A plant whose springs hang slack and whose button touches a cylinder, if anything."""
    springs = tuple(slack(s) for s in built_springs(rig.CASES[1]))
    return Plant(still_bones(), springs, cylinder(), **fields)


def patella_at(centre, turn=None, velocity=STILL, spin=STILL) -> Frame:
    """With the button's middle at a place; velocities are of the centre of mass."""
    turn = np.eye(3) if turn is None else turn
    return Frame(np.array(centre) - turn @ BUTTON, turn, np.array(velocity), np.array(spin))


GROUND = Frame(STILL, np.eye(3), STILL, STILL)


def test_the_plant_has_no_code_of_the_twin():
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{a.name}" for a in node.names]
            for name in names:
                own = name.split(".")[0] in sys.stdlib_module_names | {"numpy", "scipy"} or ".plant_" in name
                assert own or name in NUMBERS or name.rpartition(".")[0] in NUMBERS, name
    run = "import sys, tests.verification.rig_plant.mechanics; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True).stdout.split()
    assert "tests.verification.rig_plant.mechanics" in loaded
    assert not {"jax", "equinox", "diffrax", "pftwin.dynamics", "pftwin.model", "pftwin.geometry"} & set(loaded)


@pytest.mark.parametrize("stretch", [-0.01, 0.001, 0.03])
def test_a_springs_force_is_the_slope_of_its_energy(stretch):
    spring = Spring(156.0, 0.14, 1.5, STILL, STILL, 0.05)
    length, h = 0.14 + stretch, 1e-5
    slope = (spring.energy(length + h) - spring.energy(length - h)) / (2 * h)
    assert spring.force(length, 0.0) == pytest.approx(slope, rel=1e-6, abs=1e-12)


def test_a_spring_is_stiffer_by_its_share_at_a_quarter_of_its_length_and_never_pushes():
    spring = Spring(156.0, 0.14, 1.5, STILL, STILL, 0.05)
    assert spring.force(1.25 * 0.14, 0.0) == pytest.approx(1.05 * 156 * 0.035, rel=1e-12)
    assert spring.force(0.15, 0.2) - spring.force(0.15, 0.0) == pytest.approx(0.3, rel=1e-12)
    assert spring.force(0.15, -10.0) == 0
    assert spring.force(0.139, 10.0) == 0


def test_a_bone_that_turns_evenly_has_that_angular_velocity_at_any_quaternion_length():
    times = np.linspace(0.0, 0.4, 41)
    half = 0.5 * 3.0 * times  # 3 rad/s about z
    quaternions = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    origins = np.outer(times, [0.1, -0.2, 0.3])
    bones = GuidedBones(times, (origins, quaternions), (origins, 2 * quaternions))
    for bone in bones.at(0.1234):
        place, velocity = bone.point(np.array([0.02, 0.0, 0.0]))
        turn = np.array([np.cos(0.3702), np.sin(0.3702), 0.0])
        np.testing.assert_allclose(bone.spin, [0, 0, 3], atol=1e-6)
        np.testing.assert_allclose(place, 0.1234 * np.array([0.1, -0.2, 0.3]) + 0.02 * turn, atol=1e-9)
        np.testing.assert_allclose(velocity, [0.1, -0.2, 0.3] + 0.06 * np.array([-turn[1], turn[0], 0]), atol=1e-7)
        np.testing.assert_allclose(bone.velocity_at(place), velocity, atol=1e-12)


@pytest.mark.parametrize("angle", [-0.5, 0.0, 0.6])
def test_on_a_cylinder_the_contact_is_hertzian_and_radial(angle):
    indentation, rate = 3e-5, 0.02
    out = np.array([np.sin(angle), 0.0, np.cos(angle)])
    centre = (R + rig.BUTTON_RADIUS - indentation) * out
    still = in_the_air(drag=(0.0, 0.0)).forces(patella_at(centre), GROUND, GROUND)
    hertz = 2e8 * indentation**1.5
    assert still.contact == pytest.approx(hertz, rel=1e-9)
    np.testing.assert_allclose(still.force - rig.MASS * np.array(rig.GRAVITY), hertz * out, atol=1e-8)
    np.testing.assert_allclose(still.moment, cross(BUTTON, hertz * out), atol=1e-8)
    closing = in_the_air(drag=(0.0, 0.0)).forces(patella_at(centre, velocity=-rate * out), GROUND, GROUND)
    assert closing.contact == pytest.approx(hertz * (1 + 1.5 * rate), rel=1e-9)
    assert in_the_air().forces(patella_at(centre + 1e-4 * out), GROUND, GROUND).contact == 0


def test_friction_opposes_the_sliding_of_the_buttons_skin():
    indentation, speed = 3e-5, 4e-3
    centre = np.array([0.0, 0.0, R + rig.BUTTON_RADIUS - indentation])
    smooth, rough = (in_the_air(drag=(0.0, 0.0), friction=mu) for mu in (0.0, FRICTION))
    sliding = patella_at(centre, velocity=[0.0, speed, 0.0])
    drag = FRICTION * 2e8 * indentation**1.5 * speed / np.hypot(speed, STICTION_SPEED)
    forces = [p.forces(sliding, GROUND, GROUND) for p in (smooth, rough)]
    np.testing.assert_allclose(forces[1].force - forces[0].force, [0, -drag, 0], atol=1e-9)
    arm = BUTTON - [0, 0, rig.BUTTON_RADIUS]
    np.testing.assert_allclose(forces[1].moment - forces[0].moment, cross(arm, np.array([0, -drag, 0])), atol=1e-9)
    rolling = patella_at(centre, velocity=cross(np.array([2.0, 0, 0]), -arm), spin=[2.0, 0, 0])
    forces = [p.forces(rolling, GROUND, GROUND) for p in (smooth, rough)]
    np.testing.assert_allclose(forces[1].force, forces[0].force, atol=1e-9)


def test_a_knee_that_moves_as_one_has_the_forces_of_rest(plant, rest):
    """Damping, drag and friction know relative velocities alone."""
    femur, tibia = plant.bones.at(0.0)
    patella = Frame(rest[:3], matrix(rest[3:7]), STILL, STILL)
    velocity, spin = np.array([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -3.0])
    moving = [b._replace(velocity=velocity + cross(spin, b.origin), spin=spin) for b in (patella, femur, tibia)]
    still, carried = plant.forces(patella, femur, tibia), plant.forces(*moving)
    assert still.contact > 5
    for a, b in zip(still[:2], carried[:2], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
        np.testing.assert_allclose(a, STILL, atol=1e-7)  # and rest is rest
    np.testing.assert_allclose(still.pulls, carried.pulls, rtol=1e-12)


def test_its_implant_is_the_component_that_the_rig_says(plant):
    """All of its surface: flange, groove, ridges, beyond them, and the notch."""
    component, r = rig_implant(), plant.contact.shape.trochlear_radius
    u, v = np.meshgrid(r * np.radians(np.linspace(-110, 50, 81)), np.linspace(-0.032, 0.032, 65))
    wanted = jax.vmap(component.height)(jnp.asarray(u.ravel()), jnp.asarray(v.ravel()))
    np.testing.assert_allclose(plant.contact.height(u, v).ravel(), wanted, atol=1e-14)


def test_minima_of_the_distance_and_the_ridge_are_those_of_a_fine_grid(plant):
    """On the trochlea the button touches on both facets."""
    contact, centre = plant.contact, np.array([0.005, 0.0, 0.0494])
    r = contact.shape.trochlear_radius
    u, v = (
        r * np.arctan2(centre[0], centre[2]) + np.linspace(-6e-3, 6e-3, 1201)[:, None],
        np.linspace(-0.015, 0.015, 1501),
    )
    least = np.sqrt(2 * contact.half_square(centre, u, v).min(axis=0))
    inner = least[1:-1]
    minima = inner[(inner < least[:-2]) & (inner < least[2:])]
    maxima = inner[(inner > least[:-2]) & (inner > least[2:])]
    found = contact.stationary(centre)
    np.testing.assert_allclose([p.distance for p in found if p.sign > 0], minima, atol=2e-9)
    np.testing.assert_allclose([p.distance for p in found if p.sign < 0], maxima, atol=2e-9)
    assert [p.sign for p in found] == [1, -1, 1]


def test_the_contact_force_is_the_slope_of_the_stored_energy_also_where_facets_overlap(plant):
    def stored(c):
        return sum(p.sign * max(rig.BUTTON_RADIUS - p.distance, 0.0) ** 2.5 for p in plant.contact.stationary(c)) / 2.5

    overlaps = 0
    for x, y, z in np.random.default_rng(0).uniform([-0.02, -0.001, 0.046], [0.02, 0.001, 0.052], (40, 3)):
        c, h = np.array([x, y, z]), 1e-6
        places = plant.contact.stationary(c)
        deep = [max(rig.BUTTON_RADIUS - p.distance, 0.0) for p in places]
        overlaps += any(p.sign < 0 and d > 0 for p, d in zip(places, deep, strict=True))
        force = sum((p.sign * d**1.5 * p.normal for p, d in zip(places, deep, strict=True)), start=STILL)
        slope = [(stored(c - e) - stored(c + e)) / (2 * h) for e in h * np.eye(3)]
        np.testing.assert_allclose(force, slope, atol=1e-4 * np.linalg.norm(force) + 1e-10)
    assert overlaps > 5


def test_no_force_jumps_where_two_contacts_become_one(plant):
    """The sphere, pressed in deep, goes across the groove: at either end it touches one facet, between them both."""
    counts, totals = [], []
    for y in np.linspace(-0.004, 0.006, 501):
        places = plant.contact.stationary(np.array([0.005, y, 0.0485]))
        counts.append(len(places))
        totals.append(sum(p.sign * max(rig.BUTTON_RADIUS - p.distance, 0.0) ** 1.5 for p in places))
    assert (counts[0], max(counts), counts[-1]) == (1, 3, 1)
    assert np.abs(np.diff(totals)).max() < 0.01 * max(totals)


def test_energy_is_conserved_without_drag_friction_and_damping(plant, rest):
    """Thrown off its rest on both facets; with the plant's drag the same throw loses much of its energy."""
    springs = tuple(s._replace(damping=0.0) for s in plant.springs)
    femur = plant.bones.at(0.0)
    bones = GuidedBones(np.linspace(0, 1, 5), *((np.tile(b.origin, (5, 1)), _quaternions(b.turn)) for b in femur))
    free = replace(plant, bones=bones, springs=springs, drag=(0.0, 0.0), friction=0.0, dissipation=0.0)
    start = rest.copy()
    start[7:10], start[10:] = [0.05, 0.02, 0.02], [0.5, -1.0, 0.3]
    times = np.linspace(0.0, 0.01, 6)
    thrown = free.energy(0.0, start) - free.energy(0.0, rest)
    assert thrown > 1e-4
    states, _ = free.motion(times, start)
    kept = [free.energy(t, y) for t, y in zip(times, states, strict=True)]
    assert np.ptp(kept) < 1e-4 * thrown
    states, _ = replace(plant, bones=bones).motion(times, start)
    assert free.energy(0.01, states[-1]) - kept[0] < -0.1 * thrown


def _quaternions(turn):
    from scipy.spatial.transform import Rotation

    return np.tile(Rotation.from_matrix(turn).as_quat(scalar_first=True), (5, 1))


def test_a_free_body_falls_and_keeps_its_angular_momentum():
    free = in_the_air(drag=(0.0, 0.0))
    start = np.concatenate([[0, 0, 1.0], NOTHING, STILL, [3.0, 4.0, -5.0]])
    solved = solve_ivp(free.change, (0, 0.3), start, rtol=1e-9, atol=1e-10)
    end = solved.y[:, -1]
    np.testing.assert_allclose(end[:3], [0, 0, 1 - 0.5 * 9.81 * 0.09], atol=1e-9)
    inertia = np.array(rig.INERTIA)
    np.testing.assert_allclose(matrix(end[3:7]) @ (inertia * end[10:]), inertia * start[10:], atol=1e-10)
    assert np.abs(end[10:] - start[10:]).max() > 0.5
