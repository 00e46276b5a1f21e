"""How many equations a scene's step is made of, and how many of them each effect adds.

Counted are the equations of the jaxpr that is compiled, those without use taken out as the compiler does; the body of a
loop counts once, however often it runs, and a call counts as what is in it.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, Var, jaxprs_in_params

from pftwin.base.spatial import Scalar
from pftwin.dynamics.frame_states import first_guide, start_before_search, starting_state
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.state import State, System
from pftwin.model.motion import MotionPiece
from pftwin.model.scene import Scene
from pftwin.studies.audit.step import guide_over, one_step, step_length

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
