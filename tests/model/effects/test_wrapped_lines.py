"""Lines of force over an obstacle: pull, rate of lengthening and energy belong together, whichever bone carries it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, G, J, energies, gravity, knee, look, record, run, settled, state_at, system, tendon, vec
from small_scene import hanging_scene

from pftwin.base.leaves import vector
from pftwin.base.spatial import Quaternion, Rotation, Vec3
from pftwin.dynamics.frame_states import first_guide
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.simulate import equilibrium, simulate
from pftwin.dynamics.state import System
from pftwin.dynamics.static_load import patella_at_rest
from pftwin.dynamics.status import Status, status_of_lines
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.model.effects.base import Instant
from pftwin.model.effects.tendon import StrandGroup
from pftwin.model.motion import Frame
from pftwin.model.number_place import start_length

# From the patella at the origin to a bone's point 10 cm along x. Obstacles are in the way, at different places.
INSERTION, ORIGIN = (0.01, 0.002, -0.004), (0.1, 0.01, 0.005)
OBSTACLES = {
    "femur": Cylinder(vec(0.055, 0.02, 0), "femur", J(0.025), vec(0.1, 0.2, 1.0)),
    "tibia": Cylinder(vec(0.055, 0.02, 0.01), "tibia", J(0.025), vec(0.1, -0.2, 1.0)),
    "patella": Cylinder(vec(0.045, -0.01, 0), "patella", J(0.02), vec(0.1, 0.2, 1.0), vec(0, 1, 0)),
}
PARTS: list[str] = ["patella", "femur", "tibia"]
R = 0.03  # of a pulley [m]


def over(obstacle: Cylinder, line: Any) -> Any:
    """A line with an obstacle."""
    return eqx.tree_at(lambda t: t.wrap, line, obstacle, is_leaf=lambda x: x is None)


def wrapped(bone: str, body: str = "femur") -> Any:
    """A tendon over the obstacle on a bone."""
    return over(OBSTACLES[bone], tendon(800.0, 0.06, insertion=INSERTION, origin=ORIGIN, body=body))


def instant(twists: dict[str, np.ndarray], time: Any = 0.0) -> Instant:
    """Patella, femur and tibia as constant twists (linear, angular) move them from the origin."""
    now, frames = look(), {}
    for part, twist in twists.items():
        v, w = (Vec3(*(J(x) for x in half)) for half in (twist[:3], twist[3:]))
        turn = Quaternion.from_rotation_vector(w * time).rotation()
        frames[part] = Frame(v * time, turn, v, w)
    p = frames["patella"]
    patella = eqx.tree_at(
        lambda q: (q.position, q.rotation, q.velocity, q.spin),
        now.patella,
        (p.origin, p.rotation, p.velocity, p.rotation.unapply(p.angular_velocity)),
    )
    return Instant(patella, frames["femur"], frames["tibia"], J(0.0), 0.0)


@pytest.mark.parametrize("body", ["femur", "tibia"])
@pytest.mark.parametrize("bone", OBSTACLES)
def test_it_lengthens_at_the_rate_that_it_says(bone, body):
    twists = dict(zip(PARTS, np.random.default_rng(3).normal(scale=0.4, size=(3, 6)), strict=True))
    line = wrapped(bone, body)

    def length(time):
        return line.line(instant(twists, time)).length

    now, rate = jax.jit(lambda: jax.jvp(length, (J(0.0),), (J(1.0),)))()
    said = line.line(instant(twists))
    assert float(now) == float(said.length)
    assert float(now) > 1.005 * np.linalg.norm(np.subtract(ORIGIN, INSERTION))  # it does wrap
    assert float(said.lengthening) == pytest.approx(float(rate), rel=1e-10)


@pytest.mark.parametrize("body", ["femur", "tibia"])
@pytest.mark.parametrize("bone", OBSTACLES)
def test_force_and_moment_are_the_gradient_of_energy(bone, body):
    line = wrapped(bone, body)

    def energy_and_wrench(d: jax.Array) -> Any:
        turn = Quaternion.from_rotation_vector(Vec3(*d[3:]))
        now = eqx.tree_at(lambda n: (n.patella.position, n.patella.rotation), look(), (Vec3(*d[:3]), turn.rotation()))
        load = line.load(now, None)[0]
        return load.energy, load.total()

    slope, wrench = jax.jit(jax.grad(energy_and_wrench, has_aux=True))(jnp.zeros(6))
    assert float(jnp.linalg.norm(slope[:3])) > 20
    np.testing.assert_allclose(-slope[:3], wrench.force.array(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(-slope[3:], wrench.moment.array(), rtol=1e-9, atol=1e-9)


def test_strands_share_an_obstacle_and_each_runs_over_it_by_itself():
    insertions = np.add(INSERTION, [[0, 0, 0], [0, -0.03, 0.01], [0, 0.004, 0.02]])
    one = jnp.ones(3)
    origin = vector(np.broadcast_to(ORIGIN, (3, 3)))
    group = StrandGroup(900 * one, 0.07 * one, 0.06 * one, 0.003 * one, vector(insertions), origin, "femur",
                        wrap=OBSTACLES["femur"], name="strands")  # fmt: skip
    together = group.line(look())
    straight = np.linalg.norm(np.subtract(ORIGIN, insertions), axis=1)
    np.testing.assert_array_equal(np.asarray(together.length) > straight + 1e-12, [True, False, True])
    for k, point in enumerate(insertions):
        alone = eqx.tree_at(lambda t: t.insertion, wrapped("femur"), vector(point)).line(look())
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            assert float(a[k]) == pytest.approx(float(b), rel=1e-14, abs=1e-16)


def test_a_line_that_touches_nothing_pulls_as_one_without_an_obstacle():
    aside = eqx.tree_at(lambda t: t.wrap.center, wrapped("femur"), vec(0.055, 0.2, 0))
    twists = dict(zip(PARTS, np.random.default_rng(4).normal(scale=0.3, size=(3, 6)), strict=True))
    straight = tendon(800.0, 0.06, insertion=INSERTION, origin=ORIGIN, body="femur")
    for a, b in zip(*(jax.tree.leaves(t.line(instant(twists))) for t in (aside, straight)), strict=True):
        assert float(a) == pytest.approx(float(b), rel=1e-13, abs=1e-15)


def test_without_an_obstacle_a_line_costs_what_it_did():
    """Two points of rigid bodies, their difference, its length, direction and rate, and the moment: no more."""
    line = tendon(insertion=INSERTION, origin=ORIGIN, body="femur")
    now = instant({part: np.zeros(6) for part in PARTS})

    def straight(now: Instant, insertion: Vec3, origin: Vec3) -> Any:
        p, f = now.patella, now.femur
        arm = p.rotation.apply(insertion)
        end = f.point(origin)
        along = end - (p.position + arm)
        length = along.norm()
        way = along * (1 / jnp.where(length > 1e-9, length, 1e-9))
        rate = way.dot(f.relative_velocity(p.velocity + p.rotation.apply(p.spin).cross(arm), end))
        return length, -rate, way, insertion.cross(p.rotation.unapply(way))

    def count(function: Any, *args: Any) -> int:
        return str(jax.make_jaxpr(function)(*args)).count(" = ")

    plain = count(straight, now, line.insertion, line.origin)
    own = count(lambda n, t: tuple(t.line(n)), now, line)
    assert plain <= own <= plain + 1  # the call by which it is traced once
    assert count(lambda n, t: tuple(t.line(n)), now, wrapped("femur")) > own + 50


def test_an_obstacle_on_the_patella_moves_with_its_centre_of_mass():
    com, place = vec(0.003, -0.002, 0.005), vec(0.001, 0.0, 0.002)
    turn = Rotation.from_array(Quaternion.from_rotation_vector(vec(0.1, 0.2, -0.1)).rotation().array())
    now = eqx.tree_at(lambda n: (n.patella.position, n.patella.rotation), look(), (place, turn))
    about = eqx.tree_at(lambda n: n.patella.position, now, place + turn.apply(com))
    for bone in OBSTACLES:
        line = wrapped(bone)
        seen, from_there = line.line(now), line.recentred(com).line(about)
        assert float(seen.length) == pytest.approx(float(from_there.length), rel=1e-13)
        np.testing.assert_allclose(seen.direction.array(), from_there.direction.array(), atol=1e-13)


def test_a_weight_on_a_tendon_over_a_pulley_swings_as_on_a_spring():
    """Straight down from the pulley: z = x0 cos(w t) about the rest, w^2 = K / m, and no energy is lost."""
    k, x0, t = 200.0, 0.004, 0.35
    pulley = Cylinder(vec(-R, 0, 0.1), "femur", J(R), vec(0, 1, 0), vec(0, 0, 1))
    away = 0.1  # from the pulley's top to the tendon's origin, level with it
    length = 0.1 + R * np.pi / 2 + away
    line = tendon(k, length - MASS * G / k, 0.0, origin=(-R - away, 0, 0.1 + R), body="femur")
    hanging = system(gravity(), over(pulley, line))
    states, _ = record(hanging, state_at(hanging, (0, 0, x0)), J(2e-4), round(t / 2e-4), BDF2())
    at = 2e-4 * np.arange(1, round(t / 2e-4) + 1)
    np.testing.assert_allclose(states.position.z, x0 * np.cos(np.sqrt(k / MASS) * at), atol=2e-3 * x0)
    np.testing.assert_allclose(states.position.x, 0, atol=1e-9)
    total = energies(hanging, states)
    np.testing.assert_allclose(total, total[0], atol=2e-3 * 0.5 * k * x0**2)


@pytest.mark.slow
def test_the_energy_budget_of_a_knee_with_a_wrapped_tendon_closes():
    """Kinetic and stored energy, heat and numerical dissipation are the work, up to an error of the step's order."""
    scene = knee(16)
    bump = Cylinder(vec(0.1, 0, 0.015), "femur", J(0.035), vec(0, 1, 0))
    straight: Any = scene.effect("quadriceps")
    bent = over(bump, straight)
    scene = scene.with_effect(bent)
    lengths = [float(start_length(scene, line)) for line in (straight, bent)]
    assert lengths[1] > lengths[0] + 2e-4  # it is pushed aside
    start, gaps = settled(scene), []
    assert bool(start.converged())
    for substeps in (10, 40):
        path, seen = run(scene, start, substeps)
        total = sum(seen.potential_energy.values(), start=seen.kinetic_energy)
        ledger = path.ledger
        assert ledger is not None
        taken = ledger.numerical_dissipation(seen.kinetic_energy)
        gaps.append(np.abs(total - total[0] - ledger.work + ledger.heat + taken).max())
        assert np.abs(ledger.work).max() > 2e-3
        assert gaps[0] < 1e-3 * np.abs(ledger.work).max()
    assert gaps[1] < 0.3 * gaps[0]


@pytest.mark.slow
def test_frames_in_which_an_end_is_within_the_obstacle_are_flagged():
    """The tibia carries the end of the patellar tendon through a thin cylinder on the femur, which it then leaves."""
    scene = replace(hanging_scene(31), motion=knee(31).motion)
    line: Any = scene.effect("patellar_tendon")
    times = scene.motion.frame_times()
    path = np.asarray(
        eqx.filter_jit(lambda m, t, p: m.frames(t).point(p).array())(scene.motion.tibia, times, line.origin)
    )
    middle, radius = path[12], 0.5 * np.linalg.norm(path[15] - path[9])
    post = Cylinder(vector(middle), "femur", J(radius), vec(0, 1, 0))
    away = path - middle
    within = np.hypot(away[:, 0], away[:, 2]) < radius
    assert 3 < within.sum() < 20
    assert not within[0]
    result = simulate(scene.with_effect(over(post, line)))
    np.testing.assert_array_equal((result.flags & Status.END_WITHIN_WRAP) > 0, within)
    assert f"({within.sum()} of 31 frames)" in result.verdict.describe()
    assert "runs straight through" in result.verdict.describe()
    assert not result.equilibrium.status
    there = eqx.tree_at(lambda c: c.center, post, vector(path[0]))
    assert equilibrium(scene.with_effect(over(there, line))).status == Status.END_WITHIN_WRAP


@eqx.filter_jit
def status_at_rest(scene: Any) -> jax.Array:
    return status_of_lines(System.of(scene), patella_at_rest(first_guide(scene), scene.center_of_mass_pose()))


def test_an_insertion_inside_a_post_is_found_relative_to_the_patellas_origin():
    """A post of 3 mm on the insertion, and one beside it by the centre of mass, which is 4.1 mm from the origin."""
    scene = knee(5)
    com = scene.patella.center_of_mass
    assert 3.5e-3 < np.linalg.norm(com.array()) < 5e-3
    line: Any = scene.effect("quadriceps")
    there = scene.start.apply(line.insertion)
    along = vec(0, 1, 0)
    found = []
    for place in (there, there - com, there + com):
        post = Cylinder(place, "femur", J(0.003), along)
        found.append(int(status_at_rest(scene.with_effect(over(post, line)))))
    assert found == [Status.END_WITHIN_WRAP, Status.OK, Status.OK]
