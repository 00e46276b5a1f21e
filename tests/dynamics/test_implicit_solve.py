"""One implicit step's change of velocity: against numpy's dense solution, momentum, and taut lines that turn."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import J, march, record, state_at, system, tendon, vec

from pftwin.base.spatial import Quaternion, Vec3, Wrench
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.integrators.implicit_solve import FEW, LEVER, SPAN, Span, change_of_velocity, load_at_end
from pftwin.dynamics.state import System
from pftwin.model.effects.base import AggregateStiffness, Drag, Load, StiffTerm

MASS, INERTIA = 0.12, (3e-5, 5e-5, 4e-5)
SYSTEM = System(J(MASS), vec(*INERTIA), ())
SPANS = Span(J(2e-3), J(7e-4))  # of different lengths, as Newmark's are
SCALE = np.repeat([1.0, 0.02], 3)  # moments are some hundredths of forces, per unit of force


class Made:
    """Loads of random numbers, and the same as matrices: all that turns with the body pulls backwards.

    Where no force is positive, none stiffens the body against turning, and Newton's law alone says what comes out.
    """

    def __init__(self, terms: int, *, group: int = 0, bed: bool = False, drag: bool = False, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.stiffness, self.damping, self.force = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
        stiff, loads = [], []
        for lead in [()] * terms + ([(group,)] if group else []):
            g = rng.normal(size=(*lead, 6)) * SCALE
            f, k, c = -rng.uniform(1, 50, lead), rng.uniform(1e3, 1e5, lead), rng.uniform(1, 50, lead)
            direction, moment = (Vec3(*(J(a) for a in np.moveaxis(x, -1, 0))) for x in (g[..., :3], g[..., 3:]))
            stiff.append(StiffTerm(direction, moment, J(f), J(f), J(k), J(c), J(0 * f)))
            for row, *values in zip(g.reshape(-1, 6), f.ravel(), k.ravel(), c.ravel(), strict=True):
                self._add(row, *values)
        loads.append(Load(stiff=tuple(stiff)))
        if bed:
            rows, k = rng.normal(size=(20, 6)) * SCALE, rng.uniform(1e3, 1e4, 20)
            own, force, c = (rows.T * k) @ rows, rng.normal(size=6) * SCALE, 1.5e-3
            loads.append(
                Load(bed=AggregateStiffness(J(force), J(force), J(own), J(c), J(0.0), vec(0, 0, 0), vec(0, 0, 0)))
            )
            self.stiffness, self.damping, self.force = self.stiffness + own, self.damping + c * own, self.force + force
        if drag:
            velocity, spin = rng.normal(size=3), rng.normal(size=3)
            loads.append(Load(drag=Drag(J(30.0), J(0.02), vec(*velocity), vec(*spin))))
            self.damping = self.damping + np.diag([30.0] * 3 + [0.02] * 3)
            self.force = self.force - np.concatenate([30.0 * velocity, 0.02 * spin])
        known = rng.normal(size=6)
        loads.append(Load(wrench=Wrench(vec(*known[:3]), vec(*known[3:]))))
        inertial = rng.normal(size=6)
        self.inertial, self.loads = Wrench(vec(*inertial[:3]), vec(*inertial[3:])), loads
        self.force = self.force + known + inertial

    def _add(self, g: np.ndarray, f: float, k: float, c: float) -> None:
        self.force = self.force + f * g
        self.stiffness, self.damping = self.stiffness + k * np.outer(g, g), self.damping + c * np.outer(g, g)

    def exact(self, span: Span) -> np.ndarray:
        """dv of M dv = h (f - (r K + C) dv)."""
        mass = np.diag([MASS] * 3 + list(INERTIA))
        h, r = float(span.impulse), float(span.displacement_gain)
        return np.linalg.solve(mass + h * (r * self.stiffness + self.damping), h * self.force)


KINDS = {
    "few": Made(FEW),
    "many": Made(FEW + 1),
    "group": Made(1, group=5),
    "bed": Made(1, bed=True),
    "drag": Made(2, drag=True),
    "all": Made(2, group=3, bed=True, drag=True),
}


@jax.jit
def solved(inertial, loads):
    dv = change_of_velocity(SYSTEM, inertial, loads, SPANS)
    ends = [load_at_end(load, dv, SPANS.displacement_gain) for load in loads]
    total = sum((e.total() for e in ends), start=inertial)
    return jnp.stack(dv), jnp.concatenate([total.force.array(), total.moment.array()])


@pytest.mark.parametrize("made", KINDS.values(), ids=KINDS.keys())
def test_the_change_of_velocity_is_newtons_law_with_every_force_at_the_steps_end(made):
    dv, _ = solved(made.inertial, made.loads)
    np.testing.assert_allclose(dv, made.exact(SPANS), rtol=1e-9)


@pytest.mark.parametrize("made", [KINDS[k] for k in ("few", "many", "group", "bed")])
def test_the_change_of_momentum_is_the_impulse_of_the_forces_at_the_end(made):
    """What `load_at_end` hands to the energy account are the forces that have moved the body."""
    dv, total = solved(made.inertial, made.loads)
    momentum = np.array([MASS] * 3 + list(INERTIA)) * dv
    np.testing.assert_allclose(momentum, float(SPANS.impulse) * total, rtol=1e-8, atol=1e-10 * np.abs(momentum).max())


def test_elastic_load_of_a_foundation_at_the_end_excludes_damping():
    made = KINDS["bed"]
    (load,) = (x for x in made.loads if x.bed is not None)
    dv = np.array([0.01, -0.02, 0.03, 0.5, -0.4, 0.3])
    end = load_at_end(load, [J(x) for x in dv], SPANS.displacement_gain).bed
    own, r = np.asarray(load.bed.stiffness), float(SPANS.displacement_gain)
    np.testing.assert_allclose(end.elastic, load.bed.elastic - r * own @ dv, rtol=1e-12)
    np.testing.assert_allclose(end.force, load.bed.force - (r + 1.5e-3) * own @ dv, rtol=1e-12)


FORCE, STEP, STIFF = 400.0, 5e-3, 8e3


def between(arm: float, length: float) -> System:
    """The patella between two opposite tendons of 400 N each, one up and one down, that end at an arm."""

    def line(side: int):
        return tendon(STIFF, length - FORCE / STIFF, 0.0, (0, 0, side * arm), (0, 0, side * (arm + length)))

    return system(line(1), line(-1), mass=MASS, inertia=INERTIA)


def test_a_foundation_turns_with_the_body_as_one_force_does():
    """Pressed with f in all, and of no stiffness: f / L across itself and f l about, whatever its direction."""
    zero = vec(0, 0, 0)
    pressed = AggregateStiffness(J(np.zeros(6)), J(np.zeros(6)), J(np.zeros((6, 6))), J(0.0), J(FORCE), zero, zero)
    push = np.array([0.3, -0.2, 0.5, 0.01, 0.02, -0.03])
    dv, _ = solved(Wrench(vec(*push[:3]), vec(*push[3:])), [Load(bed=pressed)])
    h, r = float(SPANS.impulse), float(SPANS.displacement_gain)
    body = np.array([MASS] * 3 + list(INERTIA)) + h * r * FORCE * np.repeat([1 / SPAN, LEVER], 3)
    np.testing.assert_allclose(dv, h * push / body, rtol=1e-9)


def turned(axis: int, angle: float) -> Quaternion:
    return Quaternion.from_rotation_vector(vec(*(angle * (np.arange(3) == axis))))


def test_across_taut_lines_a_step_is_backward_eulers():
    """A line of tension f and length L is a spring f / L across itself, here of the length that is reckoned with."""
    sys, x = between(0.0, SPAN), 1e-7
    after = march(sys, state_at(sys, (x, 0, 0)), STEP, 1)
    k = 2 * FORCE / SPAN
    assert float(after.velocity.x) == pytest.approx(-STEP * k * x / (MASS + STEP**2 * k), rel=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
def test_about_taut_lines_ends_a_step_is_backward_eulers(axis):
    """A far line that ends at an arm l turns the body back with f l times the angle."""
    sys, angle = between(LEVER, 1e3), 1e-6
    after = march(sys, state_at(sys, (0, 0, 0), orientation=turned(axis, angle)), STEP, 1)
    k = 2 * FORCE * LEVER
    spin = float((after.spin.x, after.spin.y)[axis])
    assert spin == pytest.approx(-STEP * k * angle / (INERTIA[axis] + STEP**2 * k), rel=1e-4)


@pytest.mark.parametrize(("integrator", "step"), [(LinearImplicit(), 2e-2), (BDF2(), 5e-3)], ids=["first", "second"])
@pytest.mark.parametrize("way", ["across", "about"])
def test_between_taut_lines_long_steps_stay_stable(integrator, step, way):
    """It swings in 20 ms and turns in 8, with nothing else to damp it: explicit, it would be thrown."""
    sys = between(LEVER, SPAN)
    start = state_at(sys, (0, 1e-3 * (way == "across"), 0), orientation=turned(0, 0.01 * (way == "about")))
    states, _ = record(sys, start, J(step), 100, integrator)
    place, angle = (np.abs(a) for a in (states.position.y, states.orientation.rotation_vector().x))
    assert place.max() < 1e-3
    assert angle.max() < 1e-2
    assert place[-1] < 1e-5
    assert angle[-1] < 5e-3


def test_a_spring_and_damper_at_the_end_are_stretched_by_what_the_step_moves_them():
    term = StiffTerm(vec(0.6, 0.0, 0.8), vec(0.0, 0.01, 0.0), J(-7.0), J(-5.0), J(2e3), J(30.0), J(0.0))
    dv, gain = [J(x) for x in (0.1, 0.2, -0.3, 1.0, 2.0, 3.0)], J(2e-3)
    (end,) = load_at_end(Load(stiff=(term,)), dv, gain).stiff
    along = 0.6 * 0.1 - 0.8 * 0.3 + 0.01 * 2.0  # m/s
    assert float(end.elastic) == pytest.approx(-5.0 - 2e-3 * 2e3 * along)
    assert float(end.force) == pytest.approx(-7.0 - (2e-3 * 2e3 + 30.0) * along)
