"""`simulate` and `equilibrium`, the library's main functions, which run on the host."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.program_cache import Program, Timed, shares_settings
from pftwin.base.runtime import warn_of_accelerator
from pftwin.dynamics.equilibrium import Solution, converged_on_host, place_unknown
from pftwin.dynamics.error_estimate import Course
from pftwin.dynamics.frame_states import (
    at_start,
    frame_states,
    relaxed_start,
    start_before_search,
    starting_equilibrium,
    substeps_for,
)
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.rebound import impact_of
from pftwin.dynamics.relaxation import ended_far_away
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import (
    Choice,
    Tried,
    accurate_enough,
    coarsest,
    most_runs,
    parse_tolerance,
    with_estimate,
)
from pftwin.dynamics.trajectory import DEFAULT_STEP, checked_integrator, checked_scene
from pftwin.model.scene import Scene, check

if TYPE_CHECKING:
    from pftwin.dynamics.equilibrium_report import EquilibriumReport
    from pftwin.results.result import Result


_solve, _relaxed = Program(starting_equilibrium), Program(relaxed_start)


@Program
def _run(
    scene: Scene, start: Solution, integrator: Integrator, substeps: Array, energy: bool
) -> tuple[Observation, Ledger | None]:
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=energy)
    return observe(scene, path), path.ledger


def settle_first_frame(scene: Scene) -> tuple[Timed, bool]:
    """Equilibrium at the first frame with the time it took, and whether it was found by damped relaxation."""
    scene = at_start(scene)
    found = _solve.timed(scene)
    if converged_on_host(found.answer):
        return found, False
    tried = [found, _relaxed.timed(scene)]
    if not ended_far_away(scene.start, tried[-1].answer):
        # Replacing the start pose keeps the scene's structure, so nothing is compiled again.
        tried.append(_solve.timed(eqx.tree_at(lambda s: s.start, scene, tried[-1].answer)))
    run, preparation = (sum(t[i] for t in tried) for i in (1, 2))
    helped = len(tried) > 2 and bool(converged_on_host(tried[-1].answer))
    return Timed((tried[-1] if helped else found).answer, run, preparation), helped


def prepare_relaxation(scene: Scene) -> None:
    """Compiles the fallback of `settle_first_frame` ahead of time for scenes of this structure."""
    _relaxed.prepare(at_start(scene.unnamed()))


def compiled_aside(
    scene: Scene,
    integrator: Integrator | None = None,
    energy: bool = True,
    before: Callable[[], Callable[[], None]] | None = None,
) -> Callable[[], object]:
    """Traces the programs of `simulate` and compiles them in other threads; the returned function waits for them.

    If both are already compiled, this does nothing. `before` traces a program that is needed earlier, and returns a
    function that compiles it.
    """
    beginning = at_start(scene)
    start = eqx.filter_eval_shape(start_before_search, beginning)
    run = (scene, start, integrator or BDF2(), jnp.asarray(1), energy)
    if _solve.at_hand(beginning) and _run.at_hand(*run):
        return lambda: None
    threads = ThreadPoolExecutor(2)
    try:
        if not shares_settings(threads):
            return lambda: None
        if before is not None:
            threads.submit(before())
        longer = threads.submit(_run.begin(*run))
        other = threads.submit(_solve.begin(beginning))
        return lambda: (longer.result(), other.result())
    finally:
        threads.shutdown(wait=False)


def simulate(
    scene: Scene,
    *,
    integrator: Integrator | None = None,
    dt: float | None = None,
    tolerance: str | float | None = None,
    energy_budget: bool = True,
    progress: Callable[[int, int, str], None] = lambda done, of, what: None,
) -> Result:
    """Simulates the patella's motion and forces over the recorded frames, starting from static equilibrium.

    Without `dt` and `tolerance`, the step is 1 ms, or a half or a quarter of it if the estimated error of path or force
    is large. Every result contains error estimates (`Result.error`) from runs of the same scene with other steps, and
    flags the frames where they are large: see `pftwin.dynamics.error_estimate`.

    Args:
        scene: the model.
        integrator: `pftwin.BDF2()` (default), of second order; `LinearImplicit()`, of first order at the same cost,
            with more numerical damping; `Newmark()`, iterated, with options as in `Newmark(rho=0.8)`;
            `QuasiStatic()`, without inertia; `ALI3P()`, the paper's formulation in natural coordinates;
            `SymplecticEuler()`, explicit; `Diffrax("Tsit5")` and other solvers of diffrax.
        dt: maximum step [s], not refined; the step is the largest up to it that divides the interval between frames.
        tolerance: instead of `dt`, the accepted error of the path or the contact force, such as "0.05 mm" or "0.5 N":
            see `pftwin.dynamics.tolerance`. The result's settings contain the step and its estimated error.
        energy_budget: compute work and heat at every step.
        progress: called before the first two runs, which are simultaneous, and before each other one, with the number
            of steps done, the most that all runs may need, and which run it is: "run 3 of at most 4".

    Returns:
        The result at the recorded frames.

    Raises:
        InputError: `scene` is not one, a parameter of it, the step or the integrator is invalid, or it is traced.

    Warns:
        PftwinWarning: JAX's default device is an accelerator, which is slow for a single motion; once per process.
            Or no tried step meets `tolerance`; the result then has the shortest step that has an error estimate.
    """
    _refuse_traced(scene, "simulate")
    warn_of_accelerator(jax.default_backend())
    check(scene)
    if tolerance is not None and dt is not None:
        raise InputError("found both dt and tolerance", where="simulate", expected="one of them")
    asked = None if tolerance is None else parse_tolerance(tolerance)
    chosen = checked_integrator(integrator or BDF2(), "simulate")
    chosen.refuse_unfit(scene.effects)
    substeps = substeps_for(scene.motion.frame_interval, DEFAULT_STEP if dt is None else dt)
    if dt is None:
        substeps += substeps % 2
    most = most_runs(substeps, fixed=dt is not None, tolerance=asked is not None)
    runs = _Runs(scene, chosen, bool(energy_budget), most, progress)
    if asked is not None:
        choice = coarsest(runs, chosen.order, asked)
    elif dt is not None:
        choice = with_estimate(runs, substeps, chosen.order)
    else:
        choice = accurate_enough(runs, substeps, chosen.order)
    return runs.result(choice)


def _refuse_traced(scene: Scene, verb: str) -> None:
    """Raises an error for what is no scene, or one inside a JAX transformation, before compilation."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(checked_scene(scene, verb))):
        raise InputError(
            "a scene inside jit, grad, vmap or another transformation of JAX",
            where=verb,
            expected="a scene of plain numbers",
            remedy="pftwin.trajectory(scene), which is pure",
        )


class _Runs:
    """Runs of one scene with different numbers of steps, with the same program and initial equilibrium."""

    def __init__(
        self,
        scene: Scene,
        integrator: Integrator,
        energy: bool,
        most: list[int],
        progress: Callable[[int, int, str], None],
    ) -> None:
        """Compiles the programs if needed, and solves for the equilibrium. `most`: see `most_runs`."""
        self._most, self._progress = most, progress
        self._scene, self._plain, self._integrator, self._energy = scene, scene.unnamed(), integrator, energy
        contact = scene.contact
        self._contact = None if contact is None else contact.name
        self._ahead = 0.0
        beginning = at_start(self._plain)
        if not _solve.at_hand(beginning):
            began = time.perf_counter()
            compiled_aside(self._plain, integrator, energy)()
            self._ahead = time.perf_counter() - began
        self._start, self._relaxed = settle_first_frame(beginning)
        self._preparation = self._time = 0.0
        self._ran: dict[int, Timed] = {}  # by number of steps between two frames

    def __call__(self, substeps: int) -> Tried[Timed]:
        """The run with `substeps` steps between two frames. The first two of `most` are always needed: run together."""
        if substeps not in self._ran:
            count, began = len(self._ran), time.perf_counter()
            steps = [n * (self._scene.motion.n_frames - 1) for n in self._most]
            which = f"run {count + 1}" if self._ran else "runs 1 and 2"
            self._progress(sum(steps[:count]), sum(steps), f"{which} of at most {len(steps)}")
            numbers = [substeps] if self._ran else self._most[:2]
            self._ran |= dict(zip(numbers, _in_threads(self._timed, numbers), strict=True))
            preparation = max(self._ran[n].preparation for n in numbers)
            self._preparation += preparation
            self._time += time.perf_counter() - began - preparation
        ran = self._ran[substeps]
        seen: Observation = ran.answer[0]
        leapt = (np.asarray(seen.status) & int(Status.STEP_TOO_LONG)).any()
        return Tried(ran, Course.of(seen, self._contact), not leapt)

    def _timed(self, substeps: int) -> Timed:
        return _run.timed(self._plain, self._start.answer, self._integrator, jnp.asarray(substeps), self._energy)

    def result(self, choice: Choice[Timed]) -> Result:
        """The result of the chosen run."""
        from pftwin.results.result import Result

        seen, ledger = choice.run.answer
        settings: dict[str, Any] = {
            "integrator": self._integrator.text,
            "dt_s": self._scene.motion.frame_interval / choice.substeps,
            "substeps": choice.substeps,
            **choice.settings,
        }
        timing = {
            "equilibrium_s": self._start.run,
            "run_s": choice.run.run,
            "estimate_s": max(0.0, self._time - choice.run.run),
            "compile_s": self._ahead + self._start.preparation + self._preparation,
        }
        start, impact = self._start.answer, None
        if ledger is not None:
            impact = impact_of(self._scene, self._integrator, settings["dt_s"], float(ledger.approach[-1]))
        return Result.build(
            self._scene,
            start,
            seen,
            ledger,
            relaxed=self._relaxed,
            settings=settings,
            timing=timing,
            error=choice.error.with_start(place_unknown(start)),
            impact=impact,
        )


def _in_threads(run: Callable[[int], Timed], numbers: Sequence[int]) -> list[Timed]:
    """Runs with these numbers of steps, at the same time if JAX's settings allow."""
    with ThreadPoolExecutor(len(numbers)) as threads:
        if len(numbers) > 1 and shares_settings(threads):
            return list(threads.map(run, numbers))
    return list(map(run, numbers))


def equilibrium(scene: Scene) -> EquilibriumReport:
    """Solves for the static equilibrium at the scene's first frame, by descent from the start pose.

    Returns:
        A report with the pose, residual, kind of equilibrium, loaded facets, and observables of every effect. If the
        search fails, `converged` is False; no error is raised.

    Raises:
        InputError: `scene` is not one, a parameter of it is invalid, or it is traced.
    """
    from pftwin.dynamics.equilibrium_report import EquilibriumReport

    _refuse_traced(scene, "equilibrium")
    check(scene)
    solution, relaxed = settle_first_frame(scene.unnamed())
    return EquilibriumReport.build(scene, solution.answer, relaxed)
