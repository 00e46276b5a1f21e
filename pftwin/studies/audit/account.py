"""Cost of a step of a scene: equations, run time with and without a part, stiffness, and energy of each part.

Each timed frame starts from the state of the complete scene's run, so that a scene that diverges without a part is
timed along the same motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Var
from jaxtyping import Array

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Scalar
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import first_guide, start_before_search, starting_state
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.packing import Layout
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.model.effects.base import Load, StiffTerm
from pftwin.model.motion import KneeMotion, MotionPiece
from pftwin.model.scene import Scene
from pftwin.studies.audit.variants import EffectPart, load_of, parts


def guide_over(piece: MotionPiece, began: Scalar, step: Scalar) -> GuideAt:
    """Returns the bodies with prescribed motion over one step that begins at a time, between two recorded frames."""
    return lambda part: Guide.sample(piece, began + step * part)


def guides(motion: KneeMotion, index: Scalar, step: Scalar) -> Callable[[Scalar], GuideAt]:
    """Returns the bodies with prescribed motion over each step from a recorded frame to the next."""
    piece, began = motion.between_frames(index), motion.start_time + motion.frame_interval * index.astype(float)
    return lambda k: guide_over(piece, began + step * k.astype(float), step)


def step_length(motion: KneeMotion, substeps: int) -> Scalar:
    """Returns the length of a step for a number of steps per frame [s]."""
    return jnp.asarray(motion.frame_interval / substeps, dtype=float)


@Program
def through_frames(scene: Scene, states: State, integrator: Integrator, substeps: int) -> Scalar:
    """Runs all steps, each frame from its given state; returns a number that depends on all of them."""
    system, motion = System.of(scene), scene.motion
    step = step_length(motion, substeps)

    def one_frame(index: Scalar, total: Scalar) -> Scalar:
        guide_of = guides(motion, index, step)

        def further(k: Scalar, state: State) -> State:
            return integrator.advance(system, state, guide_of(k), step, None)[0]

        end = jax.lax.fori_loop(0, substeps, further, jax.tree.map(lambda a: a[index], states))
        return total + sum(jax.tree.leaves((end.position, end.velocity, end.spin)), start=end.orientation.w)

    return jax.lax.fori_loop(0, motion.n_frames - 1, one_frame, jnp.zeros((), float))


# Calls, under the names of several JAX versions; only their body is counted.
_CALLS = ("pjit", "jit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat")


def equations(scene: Scene, integrator: Integrator = LinearImplicit()) -> int:
    """Counts the equations of one step, prescribed motion included, without compiling or computing anything."""
    givens = eqx.filter_eval_shape(lambda s: _step_inputs(s, integrator), scene)
    shapes, fixed = eqx.partition(givens, lambda a: isinstance(a, jax.ShapeDtypeStruct))

    def stepped(arrays: Any) -> State:
        system, state, piece, began, step = eqx.combine(arrays, fixed)
        return integrator.advance(system, state, guide_over(piece, began, step), step, None)[0]

    return count(jax.make_jaxpr(stepped)(shapes).jaxpr)


def _step_inputs(scene: Scene, integrator: Integrator) -> tuple[System, State, MotionPiece, Scalar, Scalar]:
    """All inputs of a step, including the memory of the integrator."""
    system, step = System.of(scene), step_length(scene.motion, 1)
    state = starting_state(scene, start_before_search(scene))
    state = integrator.begin(system, state, first_guide(scene), step)
    return system, state, scene.motion.between_frames(jnp.zeros((), int)), jnp.zeros((), float), step


def count(jaxpr: Jaxpr) -> int:
    """Counts equations that contribute to the results; a call counts as its content, a loop as its body once."""
    needed = {v for v in jaxpr.outvars if isinstance(v, Var)}
    found = 0
    for eqn in reversed(jaxpr.eqns):
        if not eqn.effects and needed.isdisjoint(eqn.outvars):
            continue
        needed.update(v for v in eqn.invars if isinstance(v, Var))
        found += (eqn.primitive.name not in _CALLS) + sum(map(count, _inside(eqn.params)))
    return found


def _inside(parameters: dict[str, Any]) -> list[Jaxpr]:
    """The programs among an equation's parameters, which belong to loops, branches and calls."""
    kinds = (Jaxpr, ClosedJaxpr)
    found = jax.tree.leaves(parameters, is_leaf=lambda p: isinstance(p, kinds))
    return [p.jaxpr if isinstance(p, ClosedJaxpr) else p for p in found if isinstance(p, kinds)]


class Rates(NamedTuple):
    r"""The fastest rates that a load causes, which limit the stable step of an explicit method.

    With M the mass matrix, K = sum k g g^T and C = sum c g g^T over the load's stiff terms (and its bed's and its
    drag's), the fastest oscillation has w^2 = |M^-1/2 K M^-1/2| and damping rate y = |M^-1/2 C M^-1/2|. Semi-implicit
    (symplectic) Euler with damping taken at the step's start, v' = v - h (w^2 x + y v) and x' = x + h v', is stable up
    to h = 4 / (y + sqrt(y^2 + 4 w^2)). The norms are Frobenius norms: exact for one term, at most sqrt(6) times the
    largest eigenvalue for a group, so the estimated step is at most that much too short.
    """

    oscillation: Scalar  # w^2 [1/s^2]
    damping: Scalar  # y [1/s]

    def longest_step(self) -> Scalar:
        """Returns the longest stable step of an explicit method [s]; infinite without spring and damper."""
        rate = self.damping + jnp.sqrt(jnp.square(self.damping) + 4 * self.oscillation)
        return jnp.where(rate > 0, 4 / jnp.where(rate > 0, rate, 1.0), jnp.inf)


def rates(system: System, loads: list[tuple[float, Load]]) -> Rates:
    """Returns the rates of a signed sum of loads."""
    i = system.inertia
    lighter = 1 / jnp.sqrt(jnp.stack([system.mass, system.mass, system.mass, i.x, i.y, i.z]))
    springs = dampers = jnp.zeros((6, 6), lighter.dtype)
    for sign, load in loads:
        for term in load.stiff:
            springs = springs + sign * _gram(term, term.stiffness)
            dampers = dampers + sign * _gram(term, term.damping)
        if load.bed is not None:
            springs = springs + sign * load.bed.stiffness
            dampers = dampers + sign * load.bed.damping_time * load.bed.stiffness
        if load.drag is not None:
            three = jnp.ones(3, lighter.dtype)
            drag = jnp.concatenate([load.drag.translational * three, load.drag.rotational * three])
            dampers = dampers + sign * jnp.diag(drag)
    scale = lighter[:, None] * lighter[None, :]
    return Rates(*(jnp.sqrt(jnp.sum(jnp.square(scale * a))) for a in (springs, dampers)))


def _gram(term: StiffTerm, weight: Scalar) -> Array:
    """The sum of w g g^T over the group of a term (6, 6)."""
    parts = (getattr(v, axis) for v in (term.direction, term.moment) for axis in "xyz")
    rows = jnp.stack([jnp.ravel(jnp.broadcast_to(a, jnp.shape(weight))) for a in parts])
    return (rows * jnp.ravel(weight)[None, :]) @ rows.T


class PartAccount(NamedTuple):
    """The account of one part over the run."""

    work: Scalar  # done on the patella [J]
    moved: Scalar  # integral of the absolute power [J]
    heat: Scalar  # dissipated heat [J]
    fastest: Rates  # largest rates of any step


class Account(eqx.Module):
    """The accounts of a run."""

    states: State  # at the recorded frames (leading axis n)
    sums: tuple[PartAccount, ...]  # by part
    kinetic: Array  # (2,) kinetic energy at the start and at the end [J]


@Program
def account(scene: Scene, start: Solution, integrator: Integrator, substeps: int) -> Account:
    """Runs a scene from an equilibrium and accounts for each part.

    Power is evaluated from the loads at the end of every step: the sum of works differs from the change of kinetic
    energy by an error of first order in the step.
    """
    system, motion = System.of(scene), scene.motion
    step, listed = step_length(motion, substeps), parts(scene)
    first = Guide.sample(motion, jnp.asarray(motion.start_time, dtype=float))
    state = integrator.begin(system, starting_state(scene, start), first, step)
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(lambda: _at_end(scene, listed, state, first, step)))
    layout = Layout.of(lambda: state)

    def one_frame(now: tuple[State, Any], index: Scalar) -> tuple[tuple[State, Any], Array]:
        guide_of = guides(motion, index, step)

        def further(k: Scalar, now: tuple[State, Any]) -> tuple[State, Any]:
            guide_at = guide_of(k)
            after = integrator.advance(system, now[0], guide_at, step, None)[0]
            return after, _added(now[1], _at_end(scene, listed, after, guide_at(1.0), step))

        now = jax.lax.fori_loop(0, substeps, further, now)
        return now, layout.row(now[0])

    (last, sums), rows = jax.lax.scan(one_frame, (state, nothing), jnp.arange(motion.n_frames - 1))
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, layout.unpacked(rows))
    kinetic = jnp.stack([system.kinetic_energy(state), system.kinetic_energy(last)])
    return Account(states, sums, kinetic)


def _at_end(
    scene: Scene, listed: list[EffectPart], state: State, guide: Guide, step: Scalar
) -> tuple[PartAccount, ...]:
    """The entries of one step, evaluated at its end."""
    system, now = System.of(scene), guide.instant(state.patella(), 0.0)
    out = []
    for part in listed:
        loads = load_of(part, system.effects[part.index], now, state.memories[part.index])
        power = sum((sign * load.power(now.patella) for sign, load in loads), start=jnp.zeros_like(step))
        heat = sum((sign * load.dissipation() for sign, load in loads), start=jnp.zeros_like(step))
        out.append(PartAccount(step * power, step * jnp.abs(power), step * heat, rates(system, loads)))
    return tuple(out)


def _added(before: tuple[PartAccount, ...], new: tuple[PartAccount, ...]) -> tuple[PartAccount, ...]:
    return tuple(
        PartAccount(
            a.work + b.work, a.moved + b.moved, a.heat + b.heat, jax.tree.map(jnp.maximum, a.fastest, b.fastest)
        )
        for a, b in zip(before, new, strict=True)
    )
