"""One step of a scene: as a function of arrays, its equations counted, and its time measured with and without a part.

Every timed frame begins from the state of the whole scene's run there, so that a scene which would fly apart without a
part is timed along the same motion.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, Var, jaxprs_in_params

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Scalar
from pftwin.dynamics.frame_states import first_guide, start_before_search, starting_state
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.model.motion import KneeMotion, MotionPiece
from pftwin.model.scene import Scene


def guide_over(piece: MotionPiece, began: Scalar, step: Scalar) -> GuideAt:
    """The guided bodies over one step that began at a time, between two recorded frames."""
    return lambda part: Guide.sample(piece, began + step * part)


def step_length(motion: KneeMotion, substeps: int) -> Scalar:
    """Of so many steps between two frames [s]."""
    return jnp.asarray(motion.frame_interval / substeps, dtype=float)


def frame_time(motion: KneeMotion, index: Scalar) -> Scalar:
    """Of a recorded frame [s]."""
    return motion.start_time + motion.frame_interval * index.astype(float)


def one_step(system: System, state: State, guide_at: GuideAt, step: Scalar, integrator: Integrator) -> State:
    """The state one step later; no account is kept."""
    return integrator.advance(system, state, guide_at, step, None)[0]


@Program
def through_frames(scene: Scene, states: State, integrator: Integrator, substeps: int) -> Scalar:
    """All steps of a run, every frame from its own given state; a number that all of them enter."""
    system, motion = System.of(scene), scene.motion
    step = step_length(motion, substeps)

    def one_frame(index: Scalar, total: Scalar) -> Scalar:
        piece, began = motion.between_frames(index), frame_time(motion, index)

        def further(k: Scalar, state: State) -> State:
            return one_step(system, state, guide_over(piece, began + step * k.astype(float), step), step, integrator)

        end = jax.lax.fori_loop(0, substeps, further, jax.tree.map(lambda a: a[index], states))
        return total + sum(jax.tree.leaves((end.position, end.velocity, end.spin)), start=end.orientation.w)

    return jax.lax.fori_loop(0, motion.n_frames - 1, one_frame, jnp.zeros((), float))


# A call is what is in it, however JAX's versions name it.
_CALLS = ("pjit", "jit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat")


def equations(scene: Scene, integrator: Integrator = LinearImplicit()) -> int:
    """Of one step, the guided bodies' motion within it included. Nothing is compiled or computed."""
    givens = eqx.filter_eval_shape(lambda s: _givens(s, integrator), scene)
    shapes, fixed = eqx.partition(givens, lambda a: isinstance(a, jax.ShapeDtypeStruct))

    def stepped(arrays: Any) -> State:
        system, state, piece, began, step = eqx.combine(arrays, fixed)
        return one_step(system, state, guide_over(piece, began, step), step, integrator)

    return count(jax.make_jaxpr(stepped)(shapes).jaxpr)


def _givens(scene: Scene, integrator: Integrator) -> tuple[System, State, MotionPiece, Scalar, Scalar]:
    """All that a step starts from, what the integrator carries included."""
    system, step = System.of(scene), step_length(scene.motion, 1)
    state = starting_state(scene, start_before_search(scene))
    state = integrator.begin(system, state, first_guide(scene), step)
    return system, state, scene.motion.between_frames(jnp.zeros((), int)), jnp.zeros((), float), step


def count(jaxpr: Jaxpr) -> int:
    """Equations of which the results come; a call counts as what is in it, a loop as its body."""
    needed = {v for v in jaxpr.outvars if isinstance(v, Var)}
    found = 0
    for eqn in reversed(jaxpr.eqns):
        if not eqn.effects and needed.isdisjoint(eqn.outvars):
            continue
        needed.update(v for v in eqn.invars if isinstance(v, Var))
        found += (eqn.primitive.name not in _CALLS) + sum(map(count, jaxprs_in_params(eqn.params)))
    return found
