"""Energy account of each part of a scene along a motion: work, heat and fastest rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Scalar
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import starting_state
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.packing import Layout
from pftwin.dynamics.state import Guide, State, System
from pftwin.model.effects.base import Change, Effect, Instant, Load
from pftwin.model.scene import Scene
from pftwin.studies.audit.step import Rates, guides, rates, step_length


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


Memories = tuple[Any, ...]


@dataclass(frozen=True)
class EffectPart:
    """An effect, or a part of one."""

    name: str
    kind: str  # class that computes it
    index: int  # index of the effect in the scene
    without: Scene  # the scene without it
    forgetting: Callable[[Memories], Memories]  # converts the memories of the complete scene to those of `without`
    of: str | None = None  # the effect of which it is a part


def separable(effect: Effect) -> list[tuple[Change, Callable[[Any], Any]]]:
    """Returns the separable parts of an effect, each with the conversion of its memory to that of the rest."""
    return [(c, c.memory) for c in effect.simplifications() if c.memory is not None]


def parts(scene: Scene) -> list[EffectPart]:
    """Returns all parts of a scene, each effect before its own parts."""
    found = []
    for i, effect in enumerate(scene.effects):
        less = scene.without(effect.name)
        found.append(EffectPart(effect.name, type(effect).__name__, i, less, lambda m, i=i: (*m[:i], *m[i + 1 :])))
        for c, rest in separable(effect):
            forgetting = lambda m, i=i, rest=rest: (*m[:i], rest(m[i]), *m[i + 1 :])  # noqa: E731
            name, kind = f"{effect.name}: {c.label}", c.label.capitalize()
            found.append(EffectPart(name, kind, i, scene.with_effect(c.effect), forgetting, of=effect.name))
    return found


def load_of(part: EffectPart, effect: Effect, now: Instant, memory: Any) -> list[tuple[float, Load]]:
    """Returns the part's load as a signed sum of loads; `effect` must be prepared by `recentred`."""
    loads = [(1.0, effect.load(now, memory)[0])]
    own = [(c, rest) for c, rest in separable(effect) if part.name == f"{part.of}: {c.label}"]
    return [*loads, *((-1.0, c.effect.load(now, rest(memory))[0]) for c, rest in own)]
