"""The standard linear solid as a tendon: relaxation, creep, dynamic modulus, energy, order, derivatives, slackness."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, energies, knee, look, march, order_of, record, scalar, settled, state_at, system, vec

from pftwin.base.spatial import Vec3
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import LinearImplicit, SymplecticEuler
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tendon import Tendon
from pftwin.model.effects.viscoelastic_tendon import RELAXED, StandardLinearSolid, ViscoelasticTendon

K, K1, TAU, SLACK = 500.0, 900.0, 0.05, 0.05
R = K1 / (K + K1)
TOP = 0.1  # where the tendon hangs from: a patella at z = TOP - SLACK - s stretches it by s


def solid(k=K, k1=K1, tau=TAU) -> StandardLinearSolid:
    return StandardLinearSolid(scalar(k), scalar(k1), scalar(tau))


def tendon(k=K, k1=K1, tau=TAU) -> ViscoelasticTendon:
    parameters = (scalar(x) for x in (k, k1, tau, SLACK))
    return ViscoelasticTendon(*parameters, vec(0, 0, 0), vec(0, 0, TOP), "ground", name="tendon")


def stretched_by(s: float, velocity: float = 0.0, **now: Any):
    return look((0, 0, TOP - SLACK - s), (0, 0, -velocity), **now)


@eqx.filter_jit
def loaded(line, now, memory):
    return line.load(now, memory)


def driven(law: StandardLinearSolid, stretches: jax.Array, dashpot: jax.Array, step: float):
    """The solid over a path given at equal times, from a dashpot's stretch; one program for all steps."""
    return _driven(law, stretches, dashpot, J(step))


@eqx.filter_jit
def _driven(law: StandardLinearSolid, stretches: jax.Array, dashpot: jax.Array, step: jax.Array):
    def one(e, ends):
        pull = law.over(*ends, e, step)
        return pull.dashpot, pull

    return jax.lax.scan(one, dashpot, (stretches[:-1], stretches[1:]))[1]


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.3])
def test_held_it_relaxes_exactly_as_an_exponential_whatever_the_step(step):
    """Stretched at once by 10 mm from rest; 1 ms, 20 ms and six relaxation times a step."""
    held = jnp.full(21, 0.01)
    pull = driven(solid(), held, J(0.0), step)
    t = step * np.arange(1, 21)
    np.testing.assert_allclose(pull.tension, 0.01 * (K + K1 * np.exp(-t / TAU)), rtol=1e-12)


@eqx.filter_jit
def stiffness_and_slope(law: StandardLinearSolid, end: jax.Array, step: jax.Array):
    def tension(end):
        pull = law.over(J(0.0), end, J(0.0), step)
        return pull.tension, pull.stiffness

    slope, stiffness = jax.grad(tension, has_aux=True)(end)
    return stiffness, slope


@pytest.mark.parametrize("step", [1e-3, 0.02, 0.3])
def test_pulled_steadily_it_is_exact_whatever_the_step(step):
    """s = v t: F = K v t + K1 v tau (1 - exp(-t / tau))."""
    v, t = 0.02, step * np.arange(21)
    pull = driven(solid(), J(v * t), J(0.0), step)
    exact = K * v * t + K1 * v * TAU * (1 - np.exp(-t / TAU))
    np.testing.assert_allclose(pull.tension, exact[1:], rtol=1e-12)
    stiffness, slope = stiffness_and_slope(solid(), J(v * step), J(step))
    assert float(stiffness) == pytest.approx(float(slope), rel=1e-12)  # what an implicit step uses


@pytest.mark.parametrize("frequency", [0.3, 3.0, 30.0])
def test_storage_and_loss_modulus(frequency):
    omega, n = 2 * np.pi * frequency, 400
    step = 1 / frequency / n
    settling = int(np.ceil(16 * TAU / (step * n))) + 1
    t = step * np.arange((settling + 1) * n + 1)
    mean, size = 0.02, 0.002
    tension = np.asarray(driven(solid(), J(mean + size * np.sin(omega * t)), J(mean), step).tension)[-n:]
    phase = omega * t[-n:]
    storage, loss = (2 * np.mean(tension * f(phase)) / size for f in (np.sin, np.cos))
    wt = omega * TAU
    assert storage == pytest.approx(K + K1 * wt**2 / (1 + wt**2), rel=1e-4)
    assert loss == pytest.approx(K1 * wt / (1 + wt**2), rel=1e-3)


def test_under_a_weight_it_creeps():
    """A load put on at once: s(t) = F / K (1 - K1 / (K + K1) exp(-t / t_c)), t_c = tau (K + K1) / K. Light, damped."""
    mass, load = 1e-4, 2.0
    sys = system(
        tendon(),
        Gravity(J(mass), vec(0, 0, -load / mass)),
        LinearDamping(J(0.3), J(0.0), body="ground"),
        mass=mass,
    )
    start = state_at(sys, (0, 0, TOP - SLACK - load / (K + K1)))
    start = eqx.tree_at(lambda s: s.memories[0], start, J(0.0))
    slow = TAU * (K + K1) / K
    for t in (0.05, 0.2, 0.6):
        s = TOP - SLACK - float(march(sys, start, t, 2000).position.z)
        assert s == pytest.approx(load / K * (1 - R * np.exp(-t / slow)), rel=4e-3)


def test_a_loose_strand_recovers_as_a_free_one_does():
    """Let go it pulls nothing, and its dashpot shortens with the creep's time, tau (K + K1) / K."""
    pull = driven(solid(), jnp.full(2001, -0.01), J(0.004), 1e-4)
    assert not np.any(pull.tension)
    assert not np.any(pull.stiffness)
    t = 1e-4 * np.arange(1, 2001)
    np.testing.assert_allclose(pull.dashpot, 0.004 * np.exp(-t * K / (K + K1) / TAU), rtol=1e-5)


def test_it_never_pushes_and_comes_taut_where_its_free_length_is():
    """Stretched to 10 mm, held until relaxed, brought back quickly: it lets go at K1 / (K + K1) of the stretch."""
    for s, taut in ((R * 0.01 * 1.001, True), (R * 0.01 * 0.999, False), (-0.02, False)):
        load, _ = loaded(tendon(), stretched_by(s), J(0.01))
        force = float(load.stiff[0].force)
        assert force == pytest.approx(max((K + K1) * s - K1 * 0.01, 0), abs=1e-12)
        assert (force > 0) is taut


def path_of_all_sorts(n: int) -> tuple[np.ndarray, float]:
    """Stretches, lets go, hangs loose, is caught again: stretches over one second, and the step."""
    t = np.linspace(0, 1, n + 1)
    return 0.01 * np.sin(7 * t) + 0.004 * np.sin(23 * t), 1 / n


def test_work_is_what_is_stored_and_what_is_lost():
    gaps = []
    for n in (500, 1000, 2000):
        s, step = path_of_all_sorts(n)
        pull = jax.tree.map(np.asarray, driven(solid(), J(s), J(0.0), step))
        tension = np.concatenate([[0.0], pull.tension])
        assert 0.1 < np.mean(tension == 0) < 0.9
        work = np.trapezoid(tension, s)
        heat = step * np.sum(pull.heat)
        assert np.all(pull.heat >= 0)
        assert heat > 0.2 * float(np.max(pull.energy))
        gaps.append(abs(work - heat - float(pull.energy[-1])) / heat)
    assert gaps[0] < 2e-3
    assert gaps[-1] < 0.3 * gaps[0]  # the trapezoids' error


def bobbing(mass: float = 0.12):
    """A weight that swings on the tendon, which stays taut."""
    sys = system(tendon(), Gravity(J(mass), vec(0, 0, -9.81)), mass=mass)
    return sys, state_at(sys, (0, 0, TOP - SLACK - 0.0045))


kinetic_of = eqx.filter_jit(lambda sys, states: jax.vmap(sys.kinetic_energy)(states))


@pytest.mark.parametrize(
    "integrator", [LinearImplicit(), pytest.param(SymplecticEuler(), marks=pytest.mark.slow)], ids=lambda i: i.text
)
def test_a_swinging_weight_closes_its_energy_budget(integrator):
    sys, start = bobbing()
    gaps = []
    for n in (800, 1600, 3200):
        states, ledger = record(sys, start, J(0.2 / n), 3200, integrator)  # one program: the first n steps count
        states = replace(states, solver_state=None)  # the integrator's own
        total = energies(sys, jax.tree.map(lambda a, b: J(np.concatenate([a[None], b])), start, states))
        ledger, kinetic = jax.tree.map(np.asarray, (ledger, kinetic_of(sys, states)))
        taken = (ledger.done - kinetic)[n - 1]
        gaps.append(float(total[n] - total[0] - ledger.work[n - 1] + ledger.heat[n - 1] + taken))
        heat = float(ledger.heat[n - 1])
    assert heat > 2e-4
    assert abs(gaps[-1]) < 0.02 * heat
    assert np.all(order_of(np.abs(gaps)) > 0.8)


@pytest.mark.parametrize("integrator", [LinearImplicit(), SymplecticEuler()], ids=lambda i: i.text)
def test_its_motion_converges_with_the_first_order(integrator):
    sys, start = bobbing()
    at = [float(march(sys, start, 0.15, n, integrator).position.z) for n in (800, 1600, 3200, 6400, 204800)]
    errors = np.abs(np.array(at[:-1]) - at[-1])
    np.testing.assert_allclose(order_of(errors), 1, atol=0.15)


def test_the_motion_is_that_of_the_closed_form():
    """Mass, K, K1, tau: three linear equations, solved by the matrix exponential."""
    from scipy.linalg import expm

    mass = 0.12
    sys, start = bobbing(mass)
    a = np.array([[0, 1, 0, 0], [-(K + K1) / mass, 0, K1 / mass, 9.81], [1 / TAU, 0, -1 / TAU, 0], [0, 0, 0, 0]])
    exact = expm(0.15 * a) @ [0.0045, 0, 0.0045, 1]
    after = march(sys, start, 0.15, 51200)
    assert TOP - SLACK - float(after.position.z) == pytest.approx(exact[0], rel=2e-3)
    assert float(after.memories[0]) == pytest.approx(exact[2], rel=2e-3)


@pytest.mark.parametrize("step", [1e-3, 5e-3, 0.05])
def test_a_step_of_any_length_is_stable_on_a_stiff_tendon(step):
    """A tendon of 200 kN/m holds the weight: 200 oscillations a second, of which such steps see nothing."""
    sys = system(tendon(1e5, 1e5, 0.02), Gravity(J(0.12), vec(0, 0, -9.81)))
    start = state_at(sys, (0, 0, TOP - SLACK - 1.4e-5))
    after = march(sys, start, 2000 * step, 2000)
    assert TOP - SLACK - float(after.position.z) == pytest.approx(0.12 * 9.81 / 1e5, rel=1e-6)


def test_without_its_second_spring_it_is_a_tendon():
    plain = Tendon(scalar(K), scalar(SLACK), scalar(0.0), vec(0, 0, 0), vec(0, 0, TOP), "ground", name="tendon")
    for s in (-0.01, 0.004):
        now = stretched_by(s, 0.1)
        one, two = loaded(plain, now, None)[0], loaded(tendon(k1=0.0), now, J(0.002))[0]
        for of in (lambda x: x.total().force.z, lambda x: x.energy, lambda x: x.stiff[0].stiffness):
            assert float(of(one)) == pytest.approx(float(of(two)), abs=1e-15)


def test_a_relaxed_one_is_a_spring_of_its_long_term_stiffness():
    for s in (-0.01, 0.004):
        load, memory = loaded(tendon(), stretched_by(s), J(RELAXED))
        assert float(load.stiff[0].force) == pytest.approx(K * max(s, 0), abs=1e-12)
        assert float(load.stiff[0].stiffness) == (K if s > 0 else 0)
        assert float(load.energy) == pytest.approx(0.5 * K * max(s, 0) ** 2)
        assert float(load.dissipation()) == 0
        assert float(memory) == RELAXED


def viscoelastic_knee():
    """The small knee with a viscoelastic patellar tendon of the same long-term stiffness."""
    scene = knee(21)
    t = scene.effect("patellar_tendon")
    assert isinstance(t, Tendon)
    wants = ViscoelasticTendon(t.stiffness, 2 * t.stiffness, J(0.04), t.slack_length, t.insertion, t.origin, t.body,
                               name=t.name)  # fmt: skip
    return scene, scene.with_effect(wants)


@pytest.mark.slow
def test_a_motion_starts_with_the_branch_relaxed():
    plain, viscous = viscoelastic_knee()
    one, two = settled(plain), settled(viscous)
    assert bool(two.converged())
    np.testing.assert_allclose(one.pose.position.array(), two.pose.position.array(), atol=1e-9)
    states = eqx.filter_jit(frame_states)(viscous, start=two).states
    lengths = np.asarray(states.memories[2])
    assert lengths[0] == RELAXED
    assert np.all(lengths[1:] > 0)
    assert np.ptp(lengths[1:]) > 1e-4


@pytest.fixture(scope="module")
def ends():
    """Where a weight on the tendon ends after 0.1 s [mm], by the tendon's K, K1, tau and L0 (relative); twice."""
    sys, start = bobbing()

    def where(s):
        t = s.effects[0]
        return [t.stiffness, t.maxwell_stiffness, t.relaxation_time, t.slack_length]

    def end(theta):
        changed = eqx.tree_at(where, sys, [a * (1 + x) for a, x in zip(where(sys), theta, strict=True)])
        states, _ = record(changed, eqx.tree_at(lambda s: s.memories[0], start, J(RELAXED)), J(1e-3), 100)
        found = 1e3 * states.position.z[-1]
        return found, found

    return end


@pytest.mark.slow
def test_derivatives_of_a_motion_are_its_differences(ends):
    zero, step = jnp.zeros(4), 1e-5
    by_forward, by_reverse = (jax.jit(by(ends, has_aux=True)) for by in (jax.jacfwd, jax.jacrev))
    forward, reverse = (np.asarray(by(zero)[0]) for by in (by_forward, by_reverse))
    sides = [[by_forward(J(s * step * e))[1] for s in (1, -1)] for e in np.eye(4)]
    apart = [float(high - low) / (2 * step) for high, low in sides]
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)
    np.testing.assert_allclose(forward, apart, rtol=1e-5)
    assert np.all(np.abs(forward) > 1e-3)  # every parameter tells


def test_gradients_are_finite_slack_taut_and_between():
    def force(k, k1, tau, stretch, e):
        pull = solid(k, k1, tau).over(stretch, stretch + 1e-4, e, 1e-3)
        return pull.tension + pull.heat + pull.energy + pull.dashpot

    slopes = jax.jit(jax.vmap(jax.grad(force, (0, 1, 2, 3, 4)), (None, None, None, 0, 0)))
    s, e = J([-0.01, 0.0, 0.004, 0.004, -0.01]), J([0.0, 0.0, 0.0, RELAXED, RELAXED])
    assert all(np.all(np.isfinite(g)) for g in slopes(J(K), J(K1), J(TAU), s, e))


def test_a_group_is_the_sum_of_its_members():
    scale = np.array([1.0, 2.0, 0.5])
    group = jax.tree.map(lambda a: J(np.full(3, a)), tendon())
    group = eqx.tree_at(lambda t: (t.stiffness, t.relaxation_time), group, (J(K * scale), J(TAU * scale)))
    now = stretched_by(0.006, 0.05)
    now = eqx.tree_at(lambda n: (n.step, n.lookahead), now, (J(1e-3), J(1e-3)))
    memory = np.array([0.001, RELAXED, 0.02])
    whole, after = loaded(group, now, J(memory))
    each = [jax.tree.map(lambda a, i=i: J(np.asarray(a)[i]), group) for i in range(3)]
    parts = [loaded(one, now, J(memory[i])) for i, one in enumerate(each)]
    assert float(whole.total().force.z) == pytest.approx(sum(float(p.total().force.z) for p, _ in parts))
    assert float(whole.energy) == pytest.approx(sum(float(p.energy) for p, _ in parts))
    assert float(whole.dissipation()) == pytest.approx(sum(float(p.dissipation()) for p, _ in parts))
    np.testing.assert_allclose(after, [float(m) for _, m in parts])
    assert isinstance(now.patella.position, Vec3)
