"""A run that keeps account, step by step, of what each part of the scene does to the patella."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Scalar
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import FrameStates, starting_state
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.observe import observe
from pftwin.dynamics.packing import Layout
from pftwin.dynamics.state import Guide, State, System
from pftwin.model.scene import Scene
from pftwin.studies.audit.parts import EffectPart, load_of, parts
from pftwin.studies.audit.step import frame_time, guide_over, one_step, step_length
from pftwin.studies.audit.stiffness import Rates, rates


class PartAccount(NamedTuple):
    """Of one part over the run."""

    work: Scalar  # done on the patella [J]
    moved: Scalar  # the same, whichever way it went: the integral of the power's size [J]
    heat: Scalar  # that it turned work and what it stores into [J]
    fastest: Rates  # the largest of any step


class Account(eqx.Module):
    """The run."""

    states: State  # at the recorded frames (leading axis n)
    status: Array  # (n,) bits of `Status`
    sums: tuple[PartAccount, ...]  # by part
    kinetic: Array  # (2,) kinetic energy at the start and at the end [J]


@Program
def account(scene: Scene, start: Solution, integrator: Integrator, substeps: int) -> Account:
    """The run from an equilibrium.

    Power is taken at the end of every step, from loads looked at there: the works' sum differs from the change of
    kinetic energy by an error of first order in the step.
    """
    chosen, system, motion = integrator, System.of(scene), scene.motion
    step, listed = step_length(motion, substeps), parts(scene)
    first = Guide.sample(motion, jnp.asarray(motion.start_time, dtype=float))
    state = chosen.begin(system, starting_state(scene, start), first, step)
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(lambda: _at_end(scene, listed, state, first, step)))
    layout = Layout.of(lambda: state)

    def one_frame(now: tuple[State, Any], index: Scalar) -> tuple[tuple[State, Any], Array]:
        piece, began = motion.between_frames(index), frame_time(motion, index)

        def further(k: Scalar, now: tuple[State, Any]) -> tuple[State, Any]:
            guide_at = guide_over(piece, began + step * k.astype(float), step)
            after = one_step(system, now[0], guide_at, step, integrator)
            return after, _added(now[1], _at_end(scene, listed, after, guide_at(1.0), step))

        now = jax.lax.fori_loop(0, substeps, further, now)
        return now, layout.row(now[0])

    (last, sums), rows = jax.lax.scan(one_frame, (state, nothing), jnp.arange(motion.n_frames - 1))
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, layout.unpacked(rows))
    seen = observe(scene, FrameStates(states, None, start, step, integrator))
    kinetic = jnp.stack([system.kinetic_energy(state), system.kinetic_energy(last)])
    return Account(states, seen.status, sums, kinetic)


def _at_end(
    scene: Scene, listed: list[EffectPart], state: State, guide: Guide, step: Scalar
) -> tuple[PartAccount, ...]:
    """One step's entries, from its end."""
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
