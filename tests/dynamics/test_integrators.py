"""Every integrator by name: its declared order on smooth and on contact-rich motion, its options, its derivatives."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    MASS,
    OPTIMISED,
    gravity,
    knee,
    march,
    order_of,
    oscillator_errors,
    record,
    settled,
    state_at,
    system,
    tendon,
)
from scipy.integrate import solve_ivp
from small_scene import hanging_scene

from pftwin.base.errors import InputError
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import first_guide, frame_states, starting_state
from pftwin.dynamics.integrator import Diagnostics, Integrator
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.integrators import Newmark, newmark
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import State, System
from pftwin.dynamics.status import Status
from pftwin.model.effects.friction import Friction
from pftwin.model.scene import Scene

J = jnp.asarray
NAMES = ("linear_implicit", "linear_implicit_bdf2", "symplectic_euler", "newmark", "newmark:rho=0.5", "ali3p")
EACH = pytest.mark.parametrize("integrator", NAMES)
# With contact, a program of a quarter of a minute each: every formula once, `newmark`'s damping and `ali3p` (which has
# its own file, on the same motion) in the slow tests. The orders on smooth motion are by default those of all.
_REST = ("newmark:rho=0.5", "ali3p")


def _in_contact(names):
    return pytest.mark.parametrize(
        "integrator", [pytest.param(n, marks=pytest.mark.slow) if n in _REST else n for n in names]
    )


IN_CONTACT = _in_contact(NAMES)
SECOND_IN_CONTACT = _in_contact([n for n in NAMES if integrator_from_text(n).order == 2])
COUNTS = (100, 200, 400, 800)


@EACH
def test_order_on_a_damped_oscillator(integrator):
    errors, _ = oscillator_errors(COUNTS, integrator_from_text(integrator))
    assert order_of(errors)[-1] == pytest.approx(integrator_from_text(integrator).order, abs=0.2)


@EACH
def test_order_on_a_tumbling_top(integrator):
    """Rotations alone: the body's own axes turn under every step. A spring without stiffness makes it the program of
    the oscillator."""
    inertia, spin, duration = np.array([2e-5, 5e-5, 8e-5]), (0.3, 12.0, 0.2), 0.3
    top = system(gravity(), tendon(0.0), inertia=inertia)
    start = state_at(top, (0, 0, 0), spin=spin)
    exact = turned_by_euler(inertia, spin, duration)
    ends = [march(top, start, duration, 2 * n, integrator_from_text(integrator)) for n in COUNTS]
    errors = [np.linalg.norm(np.asarray(e.orientation.rotation().array()) - exact) for e in ends]
    assert order_of(errors)[-1] == pytest.approx(integrator_from_text(integrator).order, abs=0.25)


def turned_by_euler(inertia: np.ndarray, spin: tuple[float, ...], duration: float) -> np.ndarray:
    """A free body's rotation matrix by Euler's equations in its own axes, solved by SciPy."""

    def change(_: float, y: np.ndarray) -> np.ndarray:
        turn, rate = y[:9].reshape(3, 3), y[9:]
        by = np.cross(rate, np.eye(3)).T  # rate x v = by @ v
        return np.concatenate([(turn @ by).ravel(), np.cross(inertia * rate, rate) / inertia])

    begin = np.concatenate([np.eye(3).ravel(), spin])
    found = solve_ivp(change, (0, duration), begin, method="DOP853", rtol=1e-11, atol=1e-12)
    return found.y[:9, -1].reshape(3, 3)


@eqx.filter_jit
def path(scene: Scene, start, substeps, integrator: str):
    """Positions [mm] at the frames."""
    chosen = integrator_from_text(integrator)
    return 1e3 * frame_states(scene, integrator=chosen, substeps=substeps, start=start).states.position.array()


@pytest.fixture(scope="module")
def held():
    scene = knee(16)
    return scene, settled(scene)


@pytest.fixture(scope="module")
def fine(held):
    """By the average acceleration in steps of 0.02 ms."""
    return np.asarray(path(*held, J(500), "newmark"))


@pytest.mark.slow
@IN_CONTACT
def test_order_on_two_facets(integrator, held, fine):
    """The button slides in its groove on both facets; every integrator comes to the same motion."""
    explicit = integrator == "symplectic_euler"  # unstable where the others have long arrived
    counts = (80, 160, 320, 640) if explicit else (5, 10, 20, 40)
    errors = [np.sqrt(np.mean((np.asarray(path(*held, J(n), integrator)) - fine) ** 2)) for n in counts]
    order = integrator_from_text(integrator).order
    assert errors[-1] < (2e-3 if order == 1 else 2e-4)  # mm
    assert order_of(errors).mean() == pytest.approx(order, abs=0.35)


def test_the_second_order_step_is_the_better_one_at_equal_cost(held, fine):
    """At 5 ms and at 2 ms: same number of force evaluations, an error several times smaller."""
    for n in (2, 5):
        one, two = (np.sqrt(np.mean((np.asarray(path(*held, J(n), name)) - fine) ** 2)) for name in NAMES[:2])
        assert two < one / 2


K = 200.0


def between_springs(stiffness: float = K):
    """Held from above and from below by two taut springs of 2 K in all: linear along z, at rest in the middle."""
    pull = (stiffness, 0.05, 0.0, (0, 0, 0))
    return system(tendon(*pull, (0, 0, 0.1), name="above"), tendon(*pull, (0, 0, -0.1), name="below"))


@pytest.mark.slow
def test_with_friction_too(held):
    """Friction goes by what normal forces really came to, whatever velocity a step looked ahead with."""
    scene = held[0]
    rough = scene.with_effect(scene.effects[3].with_friction(Friction(J(0.1), J(1e-3))))
    start = settled(rough)
    fine = np.asarray(path(rough, start, J(100), "newmark"))
    errors = {n: np.sqrt(np.mean((np.asarray(path(rough, start, J(10), n)) - fine) ** 2)) for n in NAMES[:2]}
    assert errors["linear_implicit"] < 0.1  # mm
    assert errors["linear_implicit_bdf2"] < 0.3 * errors["linear_implicit"]
    smooth = np.asarray(path(scene, held[1], J(10), "newmark"))
    assert np.abs(fine[-1] - smooth[-1]).max() > 0.05  # friction matters here


def test_average_acceleration_keeps_the_energy_of_springs():
    """The trapezoidal rule keeps it to rounding where forces are linear; the damped method spends some."""
    sprung, x0 = between_springs(), 0.02
    for name in ("newmark", "newmark:rho=0.5"):
        states, _ = record(sprung, state_at(sprung, (0, 0, x0)), J(2e-3), 200, integrator_from_text(name))
        z, v = np.asarray(states.position.z), np.asarray(states.velocity.z)
        assert np.abs(z).max() < 1.001 * x0
        assert z.min() < -0.9 * x0
        energy = (0.5 * MASS * v**2 + K * z**2) / (K * x0**2)
        if name == "newmark":
            np.testing.assert_allclose(energy, 1, rtol=1e-6)
        else:
            assert 0.9 < energy[-1] < 0.99999


def test_highest_frequencies_shrink_by_rho():
    """Springs so stiff that they swing twenty times in a step: what each step leaves of it is rho in the end."""
    sprung = between_springs(1e7)
    left = {}
    for rho in (0.0, 0.5, 1.0):
        states, _ = record(sprung, state_at(sprung, (0, 0, 1e-7)), J(1e-2), 200, Newmark(rho=rho))
        left[rho] = np.abs(np.asarray(states.position.z))[:14] / 1e-7  # of as many as above: the same programs
    assert left[0.0][7:].max() < 1e-3
    assert left[0.5][-1] / left[0.5][-2] == pytest.approx(0.5, rel=0.2)  # a double root: times 1 + 1 / n
    assert 0.9 < left[1.0].min() <= left[1.0].max() < 1.001


@pytest.fixture(scope="module")
def slopes(held):
    """By the quadriceps' stiffness, of the newmark path: forward, reverse and by central differences."""
    scene, start = held

    def total(factor, integrator):
        soft = eqx.tree_at(lambda s: s.effects[1].stiffness, scene, scene.effects[1].stiffness * (1 + factor))
        chosen = integrator_from_text(integrator)
        return jnp.sum(frame_states(soft, integrator=chosen, substeps=4, start=start).states.position.array()[-1])

    def compiled(function):
        return jax.jit(function, compiler_options=OPTIMISED)  # unoptimised, the reverse mode takes minutes to compile

    found, h, one = {}, 1e-5, J(1.0)
    for name in ("newmark", "linear_implicit_bdf2"):
        value = partial(total, integrator=name)
        forward = compiled(lambda f, value=value: jax.jvp(value, (f,), (one,)))  # with the values, for the differences
        ends = [float(forward(J(x))[0]) for x in (h, -h)]
        slope, reverse = float(forward(J(0.0))[1]), float(compiled(jax.grad(value))(J(0.0)))
        found[name] = slope, reverse, (ends[0] - ends[1]) / (2 * h)
    return found


@pytest.mark.parametrize("integrator", ["newmark", "linear_implicit_bdf2"])
@pytest.mark.slow
def test_derivatives(integrator, slopes):
    forward, reverse, difference = slopes[integrator]
    assert reverse == pytest.approx(forward, rel=1e-9)
    assert forward == pytest.approx(difference, rel=1e-3)
    assert abs(forward) > 1e-5


@SECOND_IN_CONTACT
@pytest.mark.slow
def test_the_energy_budget_closes_with_the_second_order(integrator, held):
    """What is left over of work, heat and energy shrinks with the square of the step, or is rounding."""
    scene, start = held

    chosen = integrator_from_text(integrator)

    @eqx.filter_jit
    def gap(substeps):
        seen = frame_states(scene, integrator=chosen, substeps=substeps, start=start, ledger=True)
        energies = observe(scene, seen)
        whole = energies.kinetic_energy + sum(energies.potential_energy.values())
        return whole[-1] - whole[0] - seen.ledger.work[-1] + seen.ledger.heat[-1], seen.ledger.work[-1]

    (coarse, _), (middle, _), (least, work) = (gap(J(n)) for n in (10, 20, 40))
    assert abs(float(work)) > 1e-3
    assert abs(float(coarse)) < 0.01 * abs(float(work))
    assert abs(float(least)) < 0.6 * abs(float(middle)) or abs(float(least)) < 1e-4 * abs(float(work))


def test_a_step_whose_equations_are_not_solved_says_so(monkeypatch):
    scene = hanging_scene(11)
    start = settled(scene)
    monkeypatch.setattr(newmark, "MOST_ITERATIONS", 1)

    def flags(s: Scene):
        return observe(s, frame_states(s, integrator=Newmark(), substeps=1, start=start)).status

    cut_off = eqx.filter_jit(flags)
    assert (np.asarray(cut_off(scene)) & int(Status.STEP_TOO_LONG)).any()


def begun(chosen: Integrator, scene: Scene, start: Solution) -> State:
    """The first state, with what an integrator carries."""
    return chosen.begin(System.of(scene), starting_state(scene, start), first_guide(scene), J(1e-3))


def test_what_an_integrator_carries_it_knows(held):
    """Whoever shows a motion asks the integrator, not what its fields are called."""
    for name in (*NAMES, "quasi_static", "diffrax:Tsit5"):
        chosen = integrator_from_text(name)
        state = eqx.filter_eval_shape(begun, chosen, *held)
        solver_state, diagnostics = state.solver_state, eqx.filter_eval_shape(chosen.diagnostics, state)
        fields = set(getattr(solver_state, "_fields", ())) & set(Diagnostics._fields)
        assert {n for n, value in diagnostics._asdict().items() if value is not None} == fields
        assert chosen.inertia is (name != "quasi_static")


def test_a_frame_tells_of_the_worst_of_its_steps(held):
    chosen = integrator_from_text("newmark")
    state = eqx.filter_jit(begun)(chosen, *held)
    bad = eqx.tree_at(lambda s: s.solver_state.residual, state, J(0.3))
    assert float(chosen.diagnostics(chosen.with_worst_residual(state, bad)).residual) == 0.3
    assert float(chosen.diagnostics(chosen.with_residual_cleared(bad)).residual) == 0
    alone = integrator_from_text("linear_implicit")
    state = eqx.filter_jit(starting_state)(*held)
    assert alone.with_residual_cleared(state) is state
    assert alone.diagnostics(state).residual is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("euler", "no integrator 'euler'"),
        ("linear_implicit:gamma=1", "it has no options"),
        ("newmark:delta=1", "name=value, of: gamma, beta, rho"),
        ("newmark:gamma=", "name=value"),
        ("newmark:gamma=nan", "name=value"),
        ("newmark:gamma=0.4", "stable at any step"),
        ("newmark:gamma=0.5,beta=0.1", "stable at any step"),
        ("newmark:rho=1.5", "from 0"),
        ("newmark:rho=0.5,gamma=0.5", "one or the other"),
        ("ali3p:penalty=1", "at least 10 times the patella's mass"),
        ("ali3p:gamma=0.5", "name=value, of: penalty"),
    ],
)
def test_names_and_options_that_cannot_be(name, words):
    with pytest.raises(InputError, match=words):
        integrator_from_text(name)
    assert integrator_from_text("newmark:gamma=0.6").order == 1
