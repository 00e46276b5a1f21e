"""Every integrator by name: its declared order on smooth and on contact-rich motion, its options, its derivatives."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import MASS, G, gravity, knee, march, order_of, record, settled, state_at, system, tendon

from pftwin.dynamics import newmark
from pftwin.dynamics.integrators import integrator_named
from pftwin.dynamics.observe import Status, observe
from pftwin.dynamics.trajectory import trajectory
from pftwin.errors import InputError
from pftwin.scene import Scene

J = jnp.asarray
NAMES = ("linear_implicit", "linear_implicit_bdf2", "symplectic_euler", "newmark", "newmark:rho=0.5")
EACH = pytest.mark.parametrize("integrator", NAMES)
SECOND = pytest.mark.parametrize("integrator", [n for n in NAMES if integrator_named(n).order == 2])
COUNTS = (100, 200, 400, 800)


@EACH
def test_order_on_a_damped_oscillator(integrator):
    k, c, slack, x0, t = 200.0, 1.2, 0.05, 0.004, 0.35
    hanging = system(gravity(), tendon(k, slack, c))
    rest = 0.1 - slack - MASS * G / k
    start = state_at(hanging, (0, 0, rest + x0))
    w, zeta = np.sqrt(k / MASS), c / (2 * np.sqrt(k * MASS))
    damped = w * np.sqrt(1 - zeta**2)
    exact = x0 * np.exp(-zeta * w * t) * (np.cos(damped * t) + zeta * w / damped * np.sin(damped * t))
    ends = [march(hanging, start, t, n, integrator) for n in COUNTS]
    errors = [abs(float(e.position.z) - rest - exact) for e in ends]
    assert order_of(errors)[-1] == pytest.approx(integrator_named(integrator).order, abs=0.2)


@EACH
def test_order_on_a_tumbling_top(integrator):
    """Rotations alone: the body's own axes turn under every step."""
    inertia = np.array([2e-5, 5e-5, 8e-5])
    top = system(inertia=inertia)
    start = state_at(top, (0, 0, 0), spin=(0.3, 12.0, 0.2))
    ends = [march(top, start, 0.3, n, integrator) for n in (*(2 * n for n in COUNTS), 25600)]
    turns = [np.asarray(e.orientation.rotation().array()) for e in ends]
    exact = (4 * turns[-1] - turns[-2]) / 3 if integrator_named(integrator).order == 2 else 2 * turns[-1] - turns[-2]
    exact = turns[-1] if integrator_named(integrator).order == 2 else exact
    errors = [np.linalg.norm(turn - turns[-1]) for turn in turns[:-1]]
    assert order_of(errors)[-1] == pytest.approx(integrator_named(integrator).order, abs=0.25)


@eqx.filter_jit
def path(scene: Scene, start, substeps, integrator: str):
    """Positions [mm] at the frames."""
    return 1e3 * trajectory(scene, integrator=integrator, substeps=substeps, start=start).states.position.array()


@pytest.fixture(scope="module")
def held():
    scene = knee(16)
    return scene, settled(scene)


@pytest.fixture(scope="module")
def fine(held):
    """By the average acceleration in steps of 0.02 ms."""
    return np.asarray(path(*held, J(500), "newmark"))


@EACH
def test_order_on_two_facets(integrator, held, fine):
    """The button slides in its groove on both facets; every integrator comes to the same motion."""
    explicit = integrator == "symplectic_euler"  # unstable where the others have long arrived
    counts = (40, 80, 160, 320) if explicit else (5, 10, 20, 40)
    errors = [np.sqrt(np.mean((np.asarray(path(*held, J(n), integrator)) - fine) ** 2)) for n in counts]
    order = integrator_named(integrator).order
    assert errors[-1] < (2e-3 if order == 1 else 2e-4)  # mm
    assert order_of(errors).mean() == pytest.approx(order, abs=0.35)


def test_the_second_order_step_is_the_better_one_at_equal_cost(held, fine):
    """At 5 ms and at 2 ms: same number of force evaluations, an error several times smaller."""
    for n in (2, 5):
        one, two = (np.sqrt(np.mean((np.asarray(path(*held, J(n), name)) - fine) ** 2)) for name in NAMES[:2])
        assert two < one / 2


def test_average_acceleration_keeps_a_springs_energy():
    """Linear in the displacement, so the trapezoidal rule keeps it to rounding; the damped method spends it."""
    k, slack = 200.0, 0.05
    hanging = system(tendon(k, slack, 0.0))
    start = state_at(hanging, (0, 0, 0.1 - slack - 0.02))
    kept = {}
    for name in ("newmark", "newmark:rho=0.5"):
        states, _ = record(hanging, start, J(2e-3), 40, name)
        stretch = 0.1 - slack - np.asarray(states.position.z)
        assert (stretch > 0).all()  # or the tendon hangs slack, and nothing is linear
        energy = 0.5 * MASS * np.asarray(states.velocity.z) ** 2 + 0.5 * k * stretch**2
        kept[name] = energy / (0.5 * k * 0.02**2)
    np.testing.assert_allclose(kept["newmark"], 1, rtol=1e-9)
    assert kept["newmark:rho=0.5"][-1] < 0.999


@pytest.mark.parametrize("rho", [0.0, 0.5, 1.0])
def test_highest_frequencies_shrink_by_rho(rho):
    """A spring so stiff that it swings thousands of times in a step: what each step leaves of it is rho."""
    k, slack, rest = 1e9, 0.05, 0.1
    hanging = system(tendon(k, slack, 0.0))
    start = state_at(hanging, (0, 0, rest - slack - 1e-3))
    states, _ = record(hanging, start, J(1e-2), 24, f"newmark:rho={rho:g}")
    left = np.abs(rest - slack - np.asarray(states.position.z)) / 1e-3
    decay = (left[-1] / left[-9]) ** (1 / 8) if left[-9] > 0 else 0.0
    assert decay == pytest.approx(rho, abs=0.12)


@pytest.fixture(scope="module")
def slopes(held):
    """By the quadriceps' stiffness, of the newmark path: forward, reverse and by central differences."""
    scene, start = held

    def total(factor, integrator):
        soft = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, scene.effects[1].stiffness * (1 + factor))
        return jnp.sum(trajectory(soft, integrator=integrator, substeps=4, start=start).states.position.array()[-1])

    found = {}
    for name in ("newmark", "linear_implicit_bdf2"):
        value = jax.jit(lambda f, name=name: total(f, name))
        h = 1e-5
        found[name] = (
            float(jax.jit(lambda f, name=name: jax.jvp(lambda g: total(g, name), (f,), (J(1.0),))[1])(J(0.0))),
            float(jax.jit(jax.grad(lambda f, name=name: total(f, name)))(J(0.0))),
            float((value(J(h)) - value(J(-h))) / (2 * h)),
        )
    return found


@pytest.mark.parametrize("integrator", ["newmark", "linear_implicit_bdf2"])
def test_derivatives(integrator, slopes):
    forward, reverse, difference = slopes[integrator]
    assert reverse == pytest.approx(forward, rel=1e-9)
    assert forward == pytest.approx(difference, rel=1e-3)
    assert abs(forward) > 1e-5


@SECOND
def test_the_energy_budget_closes_with_the_second_order(integrator, held):
    """What is left over of work, heat and energy shrinks with the square of the step, or is rounding."""
    scene, start = held

    @eqx.filter_jit
    def gap(substeps):
        seen = trajectory(scene, integrator=integrator, substeps=substeps, start=start, ledger=True)
        energies = observe(scene, seen)
        whole = energies.kinetic_energy + sum(energies.potential_energy.values())
        return whole[-1] - whole[0] - seen.ledger.work[-1] + seen.ledger.heat[-1], seen.ledger.work[-1]

    (coarse, _), (middle, _), (least, work) = (gap(J(n)) for n in (10, 20, 40))
    assert abs(float(work)) > 1e-3
    assert abs(float(coarse)) < 0.01 * abs(float(work))
    assert abs(float(least)) < 0.6 * abs(float(middle)) or abs(float(least)) < 1e-4 * abs(float(work))


def test_a_step_whose_equations_are_not_solved_says_so(held, monkeypatch):
    scene, start = held
    monkeypatch.setattr(newmark, "MOST_ITERATIONS", 1)
    cut_off = eqx.filter_jit(lambda s: observe(s, trajectory(s, integrator="newmark", substeps=1, start=start)).status)
    assert (np.asarray(cut_off(scene)) & int(Status.STEP_TOO_LONG)).any()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("euler", "no integrator 'euler'"),
        ("linear_implicit:gamma=1", "it has no options"),
        ("newmark:delta=1", "name=number, of: gamma, beta, rho"),
        ("newmark:gamma=", "name=number"),
        ("newmark:gamma=nan", "name=number"),
        ("newmark:gamma=0.4", "stable at any step"),
        ("newmark:gamma=0.5,beta=0.1", "stable at any step"),
        ("newmark:rho=1.5", "from 0"),
        ("newmark:rho=0.5,gamma=0.5", "one or the other"),
    ],
)
def test_names_and_options_that_cannot_be(name, words):
    with pytest.raises(InputError, match=words):
        integrator_named(name)
    assert integrator_named("newmark:gamma=0.6").order == 1
