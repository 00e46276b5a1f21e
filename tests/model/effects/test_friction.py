"""Friction: blocks and balls on planes as in any textbook, stable at long steps, and nothing where nothing touches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    MASS,
    RADIUS,
    G,
    J,
    contact,
    energies,
    flat_patch,
    knee,
    look,
    march,
    order_of,
    record,
    settled,
    state_at,
    system,
    vec,
)

from pftwin.base.spatial import Vec3
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import LinearImplicit, SymplecticEuler
from pftwin.dynamics.state import Guide
from pftwin.model.effects.base import Ground
from pftwin.model.effects.contact_law import ContactLaw, Flores, Hertz
from pftwin.model.effects.friction import Friction, WithFriction
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.sphere_contact import RoughSphereContact
from pftwin.model.motion import Frame

MU, CREEP = 0.3, 1e-3
BLOCK = (1e9, 1e9, 1e9)  # moments of inertia of a thing that does not turn
DEEP = (MASS * G / 2e8) ** (2 / 3)  # where the weight is borne


def rough(mu=MU, creep=CREEP, law: ContactLaw | None = None, surface=None) -> RoughSphereContact:
    plain = contact(Hertz(J(2e8)) if law is None else law, surface)
    made = plain.with_friction(Friction(J(mu), J(creep)))
    assert isinstance(made, RoughSphereContact)
    return made


def slope(angle: float, inertia=BLOCK, **kind: Any):
    """On a plane that the world's gravity leans against: x is downhill."""
    pull = Gravity(J(MASS), vec(G * np.sin(angle), 0, -G * np.cos(angle)))
    return system(pull, rough(**kind), inertia=inertia)


guess_of = eqx.filter_jit(lambda effect, now: effect.guess(now))
load_of = eqx.filter_jit(lambda effect, now, memory: effect.load(now, memory)[0])


def resting(sys, angle=0.0, velocity=(0, 0, 0)):
    depth = (MASS * G * np.cos(angle) / 2e8) ** (2 / 3)
    return state_at(sys, (0, 0, RADIUS - depth), velocity)


@pytest.mark.parametrize("step", [1e-3, 5e-3])
@pytest.mark.parametrize("direction", [(1, 0), (0.6, 0.8), (-0.6, 0.8)])
def test_a_block_slides_down_a_steep_slope(step, direction):
    """g (sin - mu cos), whatever direction downhill is."""
    angle, n = np.radians(30), round(0.2 / step)
    x, y = direction
    pull = Gravity(J(MASS), vec(x * G * np.sin(angle), y * G * np.sin(angle), -G * np.cos(angle)))
    sys = system(pull, rough(), inertia=BLOCK)
    after = march(sys, resting(sys, angle, (0.5 * x, 0.5 * y, 0)), n * step, n)
    faster = np.array([float(after.velocity.x), float(after.velocity.y)]) - [0.5 * x, 0.5 * y]
    exact = 0.2 * G * (np.sin(angle) - MU * np.cos(angle))
    late = MU * G * np.cos(angle) * step * (exact / 0.5 + 1)  # of first order: v at the step's end, N a step late
    np.testing.assert_allclose(faster, [x * exact, y * exact], atol=late)


@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_a_block_creeps_down_a_gentle_slope(step):
    """v_s tan / sqrt(mu^2 - tan^2): steadily, exactly, and no faster than about v_s."""
    angle = np.radians(12)
    sys = slope(angle)
    after = march(sys, resting(sys, angle), 400 * step, 400)
    exact = CREEP * np.tan(angle) / np.sqrt(MU**2 - np.tan(angle) ** 2)
    assert float(after.velocity.x) == pytest.approx(exact, rel=1e-6)
    assert exact < 1.01 * CREEP


def stopping(mu, v, creep) -> float:
    """The way to rest with the regularised law, which is v^2 / (2 mu g) for v_s = 0."""
    return (v * np.hypot(v, creep) + creep**2 * np.arcsinh(v / creep)) / (2 * mu * G)


def test_the_way_to_rest():
    sys, v = slope(0.0), 0.3
    ways = [float(march(sys, resting(sys, velocity=(v, 0, 0)), 0.5, n).position.x) for n in (500, 1000, 2000, 4000)]
    exact = stopping(MU, v, CREEP)
    assert exact == pytest.approx(v**2 / (2 * MU * G), rel=2e-4)
    errors = np.abs(np.array(ways) - exact)
    assert errors[0] < 2 * v * 1e-3  # of the way in one step: the first is without friction
    np.testing.assert_allclose(order_of(errors), 1, atol=0.15)


def test_a_sliding_ball_comes_to_roll():
    """A ball that starts without spin rolls with 5/7 of its speed: friction acts at its skin."""
    turning = 0.4 * MASS * RADIUS**2
    sys = slope(0.0, (turning,) * 3)
    after = march(sys, resting(sys, velocity=(0, 0.2, 0)), 0.1, 1000)
    assert float(after.velocity.y) == pytest.approx(0.2 * 5 / 7, rel=0.01)
    spin = after.orientation.rotate(after.spin)
    assert float(spin.x) == pytest.approx(-float(after.velocity.y) / RADIUS, rel=2e-3)


@pytest.mark.parametrize("step", [1e-3, 5e-3, 0.02])
@pytest.mark.slow
def test_it_never_turns_a_block_round_nor_keeps_it_going(step):
    """However long the step against the damper mu N / v_s: 350 kg/s on 0.12 kg."""
    sys = slope(0.0)
    states, _ = record(sys, resting(sys, velocity=(0.05, 0.02, 0)), J(step), 100)
    speed = np.asarray(states.velocity.x)
    assert np.all(speed >= 0)
    assert np.all(np.diff(speed) <= 1e-15)
    assert speed[-1] < 1e-6


@pytest.mark.parametrize("integrator", [LinearImplicit(), SymplecticEuler()], ids=lambda i: i.text)
@pytest.mark.slow
def test_heat_is_all_that_is_lost(integrator):
    sys = slope(0.0, creep=0.02)  # a damper that the explicit step can take
    gaps = []
    for n in (2000, 4000, 8000):
        start = resting(sys, velocity=(0.2, 0.1, 0))
        states, ledger = record(sys, start, J(0.1 / n), n, integrator)
        states = replace(states, solver_state=None)  # the integrator's own
        total = energies(sys, jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, states))
        assert np.all(np.diff(ledger.heat) >= -1e-15)
        gaps.append(float(total[-1] - total[0] - ledger.work[-1] + ledger.heat[-1]))
        heat = float(ledger.heat[-1])
    assert heat == pytest.approx(0.5 * MASS * 0.05, rel=0.05)
    assert np.all(np.abs(gaps) < 1e-3 * heat)


@pytest.mark.parametrize("step", [2e-5, 2e-4, 1e-3])
@pytest.mark.parametrize("gap", [1e-5, 2e-4, 4.9e-4])
def test_an_impact_slows_a_block_by_mu_times_its_normal_impulse(step, gap):
    """Though a long step looks ahead to where the surface presses hundreds of times as hard."""
    sys = system(rough(mu=0.1, law=Flores(J(2e8), J(0.5))), inertia=BLOCK)
    states, _ = record(sys, state_at(sys, (0, 0, RADIUS + gap), (0.3, 0, -0.1)), J(step), 1000)  # free after the impact
    normal = MASS * (float(states.velocity.z[-1]) + 0.1)
    along = MASS * (0.3 - float(states.velocity.x[-1]))
    assert normal > 0.1 * MASS
    assert along == pytest.approx(0.1 * normal, rel=0.05 if step > 1e-4 else 0.005)


def test_without_contact_there_is_no_friction():
    effect = rough()

    def everything(z, mu, creep, v):
        one = eqx.tree_at(lambda e: (e.friction.coefficient, e.friction.slip_speed), effect, (mu, creep))
        now = eqx.tree_at(lambda n: (n.patella.position.z, n.patella.velocity.x), look((0, 0, 0)), (z, v))
        load = one.load(now, one.guess(now))[0]
        return sum(jnp.square(x) for x in jax.tree.leaves(load.total())) + sum(t.damping for t in load.stiff)

    at = (J(RADIUS + 1e-4), J(MU), J(CREEP), J(0.2))
    value, slopes = jax.jit(jax.value_and_grad(everything, (0, 1, 2, 3)))(*at)
    assert float(value) == 0
    assert [float(g) for g in slopes] == [0, 0, 0, 0]


def test_a_contact_that_has_opened_lets_go_at_once():
    """Though it pressed hard in the step before."""
    effect = rough()

    def forces(z):
        now = look((0, 0, z), (0.3, 0, 0))
        now = eqx.tree_at(lambda n: (n.step, n.lookahead), now, (J(1e-3), J(1e-3)))
        memory = guess_of(effect, now)
        pressed = eqx.tree_at(lambda m: [p.unchanged for p in m.last], memory, [J(10.0), J(10.0)])
        return [float(t.force) for t in load_of(effect, now, pressed).stiff if not t.unilateral]

    assert sum(abs(f) for f in forces(RADIUS - 1e-6)) == pytest.approx(2 * MU * 10, rel=1e-4)
    assert sum(abs(f) for f in forces(RADIUS + 1e-6)) == 0


def test_the_force_is_the_laws_and_opposes_sliding():
    effect = rough().recentred(vec(0, 0, 0))
    for v in ((0.0, 0.0), (3e-4, 4e-4), (0.3, -0.4)):
        now = look((0, 0, RADIUS - DEEP), (*v, 0))
        load = load_of(effect, now, guess_of(effect, now))
        normal = MASS * G
        force = load.total().force.array()
        expected = [-MU * normal * x / np.sqrt(v[0] ** 2 + v[1] ** 2 + CREEP**2) for x in v]
        np.testing.assert_allclose(force, [*expected, normal], rtol=1e-9, atol=1e-12)
        moment = np.cross([0, 0, -RADIUS], [*expected, 0])
        np.testing.assert_allclose(load.total().moment.array(), moment, rtol=1e-9, atol=1e-14)
        assert float(load.dissipation()) == pytest.approx(-np.dot(expected, v))


def test_a_carpet_takes_a_block_along():
    """The femur moves under it: friction knows the relative speed alone."""
    sys = system(Gravity(J(MASS), vec(0, 0, -G)), rough(), inertia=BLOCK)
    start = resting(sys)
    zero = vec(0, 0, 0)
    belt = 0.05

    @jax.jit
    def solver_state(state, n):
        def one(i, s):
            at = Vec3(belt * 1e-3 * (i + 1).astype(float), J(0.0), J(0.0))
            femur = Frame(at, Frame.world().rotation, vec(belt, 0, 0), zero)
            return LinearImplicit().advance(sys, s, lambda _: Guide(femur, Frame.world(), J(0.0)), J(1e-3))[0]

        return jax.lax.fori_loop(0, n, one, state)

    early, late = solver_state(start, J(8)), solver_state(start, J(200))
    assert float(early.velocity.x) == pytest.approx(7e-3 * MU * G, rel=0.1)  # none in the first step
    assert float(late.velocity.x) == pytest.approx(belt, rel=1e-6)


def test_friction_goes_by_what_the_normal_force_came_to():
    """In every step by the impulse that the step before really had, through a whole impact on a stiff surface."""
    sys = system(rough(mu=0.1), inertia=BLOCK)
    states, _ = record(sys, state_at(sys, (0, 0, RADIUS + 2e-4), (0.3, 0, -0.1)), J(1e-3), 8)
    normal = MASS * np.diff(np.asarray(states.velocity.z))
    along = -MASS * np.diff(np.asarray(states.velocity.x))
    assert np.count_nonzero(normal) >= 3
    np.testing.assert_allclose(along[1:], 0.1 * normal[:-1], rtol=0.03, atol=1e-12)


def rough_knee(mu=0.1, creep=2e-3):
    scene = knee(21)
    plain = scene.contact
    assert plain is not None
    return scene, scene.with_effect(plain.with_friction(Friction(J(mu), J(creep))))


@pytest.fixture(scope="module")
def starts():
    return [settled(scene) for scene in rough_knee()]


@pytest.mark.slow
def test_a_knee_rests_where_it_would_without_friction(starts):
    """The search for equilibrium sees a patella that does not slide."""
    one, two = starts
    np.testing.assert_allclose(one.pose.position.array(), two.pose.position.array(), atol=1e-10)


@eqx.filter_jit
def path_of(scene, start, substeps, integrator=LinearImplicit()):
    """The centre of mass [mm], and the ledger's heat."""
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=True)
    assert path.ledger is not None
    return 1e3 * path.states.position.array(), path.ledger.heat


@pytest.mark.slow
def test_a_knee_moves_alike_by_two_integrators_and_at_long_steps(starts):
    """Explicit at 0.05 ms, which takes N as it is then; implicit, N a step late, at 0.1, 1 and 5 ms."""
    plain, scene = rough_knee(mu=0.1, creep=5e-3)
    explicit, heat = path_of(scene, starts[1], J(200), SymplecticEuler())
    off = {}
    for n in (100, 10, 2):
        path, _ = path_of(scene, starts[1], J(n))
        off[n] = float(jnp.abs(path - explicit).max())
    assert np.all(np.diff(heat) >= 0)
    felt = float(jnp.abs(path_of(plain, starts[0], J(100))[0] - explicit).max())
    assert felt > 0.3
    assert off[100] < 0.01 * felt
    assert off[10] < 0.1 * felt
    assert off[2] < 0.4 * felt


@pytest.fixture(scope="module")
def ends():
    """Where a ball ends [mm] that falls, bounces, slides and comes to roll, by mu, v_s, stiffness and radius; twice."""
    sys = system(Gravity(J(MASS), vec(1.0, 0.5, -G)), rough(law=Flores(J(2e6), J(0.5))))
    start = state_at(sys, (0, 1e-4, RADIUS + 0.0010))

    def where(s):
        e = s.effects[1]
        return [e.friction.coefficient, e.friction.slip_speed, e.law.contact_stiffness, e.radius]

    def end(theta):
        changed = eqx.tree_at(where, sys, [a * (1 + x) for a, x in zip(where(sys), theta, strict=True)])
        states, _ = record(changed, start, J(1e-3), 60)
        found = 1e3 * states.position.array()[-1]
        return found, found

    return end


@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)])
def test_derivatives_of_a_motion_are_its_differences(ends, mode):
    """From rest, where the speed's root has no slope, through touch and sliding."""
    slopes_and_end = jax.jit(mode(ends, has_aux=True))  # one program for both: compiling it takes longest
    slopes, step = np.asarray(slopes_and_end(jnp.zeros(4))[0]), 1e-7
    sides = [[slopes_and_end(J(s * step * e))[1] for s in (1, -1)] for e in np.eye(4)]
    apart = np.stack([(high - low) / (2 * step) for high, low in sides], 1)
    np.testing.assert_allclose(slopes, apart, rtol=1e-4, atol=1e-5)
    assert np.all(np.abs(slopes).max(axis=0) > 1e-4)


def test_at_rest_gradients_are_finite():
    """Pressed on the surface without sliding: the speed's root has no slope, the friction force has its damper's."""
    effect = rough()

    def along(v, mu, creep):
        one = eqx.tree_at(lambda e: (e.friction.coefficient, e.friction.slip_speed), effect, (mu, creep))
        now = eqx.tree_at(lambda n: n.patella.velocity.x, look((0, 0, RADIUS - DEEP)), v)
        return one.load(now, one.guess(now))[0].total().force.x

    slopes = jax.jit(jax.grad(along, (0, 1, 2)))(J(0.0), J(MU), J(CREEP))
    np.testing.assert_allclose(slopes, [-MU * MASS * G / CREEP, 0, 0], rtol=1e-9, atol=1e-12)


def test_what_a_result_shows_of_it():
    effect = rough(surface=flat_patch())
    now = look((0, 0, RADIUS - DEEP), (0.3, 0, 0))
    assert isinstance(now.femur, Ground)
    report = eqx.filter_jit(lambda: effect.observe(now, effect.guess(now)))()
    assert set(report) == set(effect.observables)
    borne = {name: float(report[f"force_{name}"]) for name in ("medial", "lateral")}
    assert sum(borne.values()) == pytest.approx(MASS * G)  # a single contact is one facet's
    for name, normal in borne.items():
        assert float(report[f"friction_{name}"]) == pytest.approx(MU * normal, rel=1e-4)
        assert np.isnan(float(report[f"slip_speed_{name}"])) == (normal == 0)
    assert float(report["force_x"]) == pytest.approx(-MU * MASS * G, rel=1e-4)
    assert float(report["force"]) == pytest.approx(MASS * G)
    assert isinstance(effect, WithFriction)
