"""Any Runge-Kutta solver of diffrax, explicit or implicit, as a step: what high accuracy is measured against.

Between two looks of the effects' memories (the steps of `dt`) the equations of motion are an ordinary differential
equation, solved to a tolerance with steps of the solver's own choosing, or in one step of constant length. The state is
one array of 13 numbers: an implicit solver then differentiates one function of one array, not a thousand scalars.
Source: Kidger 2021, On Neural Differential Equations, section 5; diffrax's documentation for each solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.state import Guide, GuideAt, State, System, acceleration
from pftwin.errors import InputError
from pftwin.spatial import Quaternion, Scalar, Vec3

if TYPE_CHECKING:
    import diffrax

MOST_STEPS = 4096  # of the solver, within one step of `dt`
ADJOINTS = {"forward": "ForwardMode", "recursive": "RecursiveCheckpointAdjoint", "direct": "DirectAdjoint"}
FIRST = 0.1  # the solver's first step, as a share of the first step of `dt`


class Carried(NamedTuple):
    """From step to step."""

    pace: Scalar  # the solver's mean step in the last one [s]
    unsettled: Scalar  # 1 where the solver gave up


def begin(system: System, state: State, guide: Guide, step: Scalar) -> State:
    """The state with a first guess of the solver's own step."""
    carried = Carried(FIRST * step, jnp.zeros_like(step))
    return eqx.tree_at(lambda s: s.carried, state, carried, is_leaf=lambda x: x is None)


def solver_named(name: str) -> diffrax.AbstractRungeKutta:
    """diffrax's solver of that name.

    Raises:
        InputError: none, or one that does not solve ordinary differential equations by itself.
    """
    import diffrax

    known = sorted(n for n in dir(diffrax) if _usable(getattr(diffrax, n)))
    if name not in known:
        raise InputError(f"no solver {name!r}", where="integrator diffrax", expected=f"one of: {', '.join(known)}")
    return getattr(diffrax, name)()


def _usable(found: Any) -> bool:
    import diffrax

    if not (isinstance(found, type) and issubclass(found, diffrax.AbstractRungeKutta)):
        return False
    return not found.__name__.startswith("Abstract") and found.term_structure is diffrax.AbstractTerm


def diffrax_step(
    system: System,
    state: State,
    guide_at: GuideAt,
    step: Scalar,
    ledger: Ledger | None = None,
    *,
    solver: str,
    rtol: float = 1e-7,
    atol: float = 1e-9,
    adaptive: bool = True,
    adjoint: str = "forward",
) -> tuple[State, Ledger | None]:
    """The state one step later, and the energy ledger where one is kept.

    Args:
        solver: diffrax's name of it.
        rtol, atol: tolerances of the error in each of the solver's steps, in metres, quaternions and their rates.
        adaptive: whether the solver chooses its steps; else it takes one of the whole length.
        adjoint: diffrax's way to differentiate: "forward", for reverse mode "recursive" (checkpoints) or "direct".
    """
    import diffrax

    def slope(t: Scalar, y: Array, _: None) -> Array:
        now = _state(y, state)
        loads, _memories = system.loads(guide_at(t / step).instant(now.patella(), 0.0), state.memories)
        a = acceleration(system, now.spin, loads)
        turning = Quaternion.from_array(y[3:7]) * Quaternion(jnp.zeros_like(t), *(0.5 * w for w in _parts(now.spin)))
        rates = [now.velocity.array(), turning.array(), a.linear.array(), a.angular.array()]
        if ledger is not None:
            zero = jnp.zeros_like(t)
            books = Ledger(zero, zero).entered(now, now, loads, None, 0.5, jnp.ones_like(t))
            rates.append(jnp.stack([books.work, books.heat]))
        return jnp.concatenate(rates)

    books = [] if ledger is None else [jnp.stack([ledger.work, ledger.heat])]
    start = [state.position.array(), state.orientation.array(), state.velocity.array(), state.spin.array(), *books]
    chosen = solver_named(solver)
    if isinstance(chosen, diffrax.AbstractImplicitSolver):
        chosen = eqx.tree_at(lambda s: s.root_finder, chosen, diffrax.VeryChord(rtol=rtol, atol=atol))
    found = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),  # pyright: ignore[reportArgumentType]
        chosen,
        t0=jnp.zeros_like(step),
        t1=step,
        dt0=jnp.minimum(state.carried.pace, step) if adaptive else step,
        y0=jnp.concatenate(start),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=atol) if adaptive else diffrax.ConstantStepSize(),
        adjoint=getattr(diffrax, ADJOINTS[adjoint])(),
        max_steps=MOST_STEPS,
        throw=False,
    )
    assert found.ys is not None
    y = found.ys[-1]
    after = _state(y, state)
    _, memories = system.loads(guide_at(1.0).instant(after.patella(), step), state.memories)
    failed = (found.result != diffrax.RESULTS.successful).astype(y.dtype)
    carried = Carried(step / jnp.maximum(found.stats["num_accepted_steps"], 1).astype(y.dtype), failed)
    after = eqx.tree_at(lambda s: (s.memories, s.carried), after, (memories, carried))
    return after, None if ledger is None else Ledger(y[13], y[14])


def _parts(v: Vec3) -> tuple[Scalar, Scalar, Scalar]:
    return v.x, v.y, v.z


def _state(y: Array, like: State) -> State:
    """The state that an array stands for; what is remembered is as in another."""
    turn = Quaternion.from_array(y[3:7]).normalised()
    velocity, spin = Vec3.from_array(y[7:10]), Vec3.from_array(y[10:13])
    return State(Vec3.from_array(y[:3]), turn, velocity, spin, like.memories, like.carried)
