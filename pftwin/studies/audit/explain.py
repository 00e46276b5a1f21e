"""Cost and action of each effect of a scene: number of equations, run time, stiffness and energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.simulate import settle_first_frame, simulate
from pftwin.dynamics.status import Status, status_facts
from pftwin.dynamics.trajectory import checked_integrator
from pftwin.model.scene import Scene, check
from pftwin.studies.audit.account import Account, PartAccount, account, equations, through_frames
from pftwin.studies.audit.variants import EffectPart, parts
from pftwin.studies.runs import Cost, time_in_turn


@dataclass(frozen=True)
class PartCost:
    """Cost of one part of a scene: an effect, or a part of one such as its friction."""

    name: str
    kind: str  # class that computes it
    of: str | None  # the effect of which it is a part
    equations: int  # number of equations that it adds to a step
    share: float  # share of a step's time that is saved without it
    spread: float  # half the interquartile range of `share` over the rounds
    longest_step: float  # longest stable explicit step with it alone, at the worst time of the run; inf: any [s]
    stiff: bool  # whether `longest_step` is less than the step
    work: float  # done on the patella over the run [J]
    moved: float  # integral of the absolute power [J]
    heat: float  # dissipated heat [J]


@dataclass(frozen=True)
class Explanation:
    """Cost of one step of a scene and of each of its parts."""

    scene: str
    integrator: str
    step: float  # [s]
    steps: int  # number of steps of the run
    equations: int  # number of equations of one step
    step_time: float  # median run time of one step [s]
    parts: tuple[PartCost, ...]
    kinetic_change: float  # change of the patella's kinetic energy over the run [J]
    flags: NDArray[np.int32]  # of every frame (n,), bits of `Status`
    verdict: str  # on the simulation: "valid", or why it is not
    programs: int  # number of compiled programs

    @property
    def shared_equations(self) -> int:
        """Number of equations that belong to no part: inertia, prescribed motion, solution of the step."""
        return self.equations - sum(p.equations for p in self.parts if p.of is None)

    @property
    def status(self) -> Status:
        """Union of the status flags of all frames."""
        return Status(int(np.bitwise_or.reduce(self.flags, initial=0)))

    @property
    def shared_time(self) -> float:
        """Share of a step's time that belongs to no part."""
        return 1 - sum(p.share for p in self.parts if p.of is None)

    @property
    def energy_gap(self) -> float:
        """Error of the account: work of all effects minus the change of kinetic energy [J]."""
        return sum(p.work for p in self.parts if p.of is None) - self.kinetic_change

    def to_dict(self) -> dict[str, Any]:
        """Returns plain values that can be written as JSON."""
        own = {k: v for k, v in asdict(self).items() if k != "flags"}
        more = ("shared_equations", "shared_time", "energy_gap")
        return {**own, **{k: getattr(self, k) for k in more}, **status_facts(self.flags)}


def explain(
    scene: Scene,
    *,
    integrator: Integrator | None = None,
    dt: float | None = None,
    progress: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> Explanation:
    """Simulates a scene, accounts for the energy of each step, and times a step with all effects and without each.

    Args:
        scene: the scene to explain.
        integrator, dt: as in `simulate`; the default step is the one that it chooses.
        progress: called with the number of programs done, their total, and a label, before each and at the end.

    Raises:
        InputError: invalid parameter of the scene, step or integrator.
    """
    check(scene)
    integrator = checked_integrator(integrator or BDF2(), "explain")
    scene, name, given = scene.unnamed(), scene.name, scene
    listed = parts(scene)
    stages = ["the scene itself", "its account", "with every effect", *(f"without {part.name}" for part in listed)]

    def before(k: int) -> None:
        progress(k, len(stages), stages[k])

    before(0)
    simulated = simulate(given, integrator=integrator, dt=dt)
    substeps = simulated.settings["substeps"]
    before(1)
    start = settle_first_frame(scene)[0].answer
    accounted: Account = account(scene, start, integrator, substeps)
    run_times = _run_times(scene, listed, accounted, integrator, substeps, lambda k: before(2 + k))
    progress(len(stages), len(stages), stages[-1])
    total, step = equations(scene, integrator), scene.motion.frame_interval / substeps
    steps = substeps * (scene.motion.n_frames - 1)
    costs = [
        _cost(part, total - equations(part.without.unnamed(), integrator), share, entry, step)
        for part, share, entry in zip(listed, run_times[1:], accounted.sums, strict=True)
    ]
    return Explanation(
        scene=name,
        integrator=integrator.text,
        step=step,
        steps=steps,
        equations=total,
        step_time=run_times[0].seconds / steps,
        parts=tuple(costs),
        kinetic_change=float(np.diff(np.asarray(accounted.kinetic, dtype=np.float64))[0]),
        flags=simulated.flags,
        verdict=simulated.verdict.describe(),
        programs=4 + len(listed),  # equilibrium, motion, account, and timed: all effects, and without each
    )


def _run_times(
    scene: Scene,
    listed: list[EffectPart],
    accounted: Account,
    integrator: Integrator,
    substeps: int,
    before: Callable[[int], None],
) -> list[Cost]:
    """Run times of the complete scene and of the scene without each part."""
    state = accounted.states
    pairs = [(scene, state)]
    pairs += [(p.without.unnamed(), replace(state, memories=p.forgetting(state.memories))) for p in listed]
    return time_in_turn([partial(through_frames, *pair, integrator, substeps) for pair in pairs], before=before)


def _cost(part: EffectPart, added: int, share: Cost, sums: PartAccount, step: float) -> PartCost:
    longest = float(sums.fastest.longest_step())
    return PartCost(
        name=part.name,
        kind=part.kind,
        of=part.of,
        equations=added,
        share=1 - share.ratio,
        spread=share.spread,
        longest_step=longest,
        stiff=longest < step,
        work=float(sums.work),
        moved=float(sums.moved),
        heat=float(sums.heat),
    )
