"""How many equations a scene's step is made of, and how many of them each effect adds.

Counted are the equations of the jaxpr that is compiled, those without use taken out as the compiler does; the body of a
loop counts once, however often it runs, and a call counts as what is in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import Literal

from pftwin.audit.step import guide_over, one_step, step_length
from pftwin.dynamics.integrators import integrator_named
from pftwin.dynamics.state import State, System
from pftwin.dynamics.trajectory import first_guide, start_before_search, starting_state
from pftwin.motion import MotionPiece
from pftwin.scene import Scene
from pftwin.spatial import Scalar

# A call is what is in it, however JAX's versions name it.
_CALLS = ("pjit", "jit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat")


def equations(scene: Scene, integrator: str = "linear_implicit") -> int:
    """Of one step, the guided bodies' motion within it included. Nothing is compiled or computed."""
    givens = eqx.filter_eval_shape(lambda s: _givens(s, integrator), scene)
    shapes, fixed = eqx.partition(givens, lambda a: isinstance(a, jax.ShapeDtypeStruct))

    def stepped(arrays: Any) -> State:
        system, state, piece, began, step = eqx.combine(arrays, fixed)
        return one_step(system, state, guide_over(piece, began, step), step, integrator)

    return _count(jax.make_jaxpr(stepped)(shapes).jaxpr)


def _givens(scene: Scene, integrator: str) -> tuple[System, State, MotionPiece, Scalar, Scalar]:
    """All that a step starts from, what the integrator carries included."""
    system, step = scene.system(), step_length(scene.motion, 1)
    state = starting_state(scene, start_before_search(scene))
    state = integrator_named(integrator).begin(system, state, first_guide(scene), step)
    return system, state, scene.motion.between_frames(jnp.zeros((), int)), jnp.zeros((), float), step


def _count(jaxpr: Any, wanted: Iterable[int] | None = None) -> int:
    """Equations that the wanted results (all by default) come from, those inside them included."""
    results = jaxpr.outvars if wanted is None else [jaxpr.outvars[i] for i in wanted]
    needed = {v for v in results if not isinstance(v, Literal)}
    total = 0
    for eqn in reversed(jaxpr.eqns):
        used = [i for i, v in enumerate(eqn.outvars) if v in needed]
        if not used and not eqn.effects:
            continue
        needed.update(v for v in eqn.invars if not isinstance(v, Literal))
        call = eqn.primitive.name in _CALLS
        total += (not call) + sum(_count(inner, used if call else None) for inner in _inside(eqn))
    return total


def _inside(eqn: Any) -> Iterator[Any]:
    """Jaxprs among an equation's parameters: bodies of loops, branches, calls."""
    for value in eqn.params.values():
        for one in value if isinstance(value, tuple | list) else (value,):
            inner = getattr(one, "jaxpr", one)
            if hasattr(inner, "eqns"):
                yield inner
