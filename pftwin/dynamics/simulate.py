"""`simulate` and `equilibrium`: the verbs of the library, on the host."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.program_cache import Program, Timed
from pftwin.base.program_cache import settings as jax_settings
from pftwin.base.spatial import Pose
from pftwin.dynamics.equilibrium import Solution, tolerance_on_host
from pftwin.dynamics.frame_states import (
    first_guide,
    frame_states,
    start_before_search,
    starting_equilibrium,
    substeps_for,
)
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.relaxation import ended_far_away, relax
from pftwin.dynamics.state import System
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import Path, coarsest, settings_of, tolerance_in_metres
from pftwin.dynamics.trajectory import checked_integrator
from pftwin.model.scene import Scene, check

if TYPE_CHECKING:
    from pftwin.dynamics.equilibrium_report import EquilibriumReport
    from pftwin.results.result import Result


@Program
def _solve(scene: Scene) -> Solution:
    return starting_equilibrium(scene)


@Program
def _relaxed(scene: Scene) -> Pose:
    pose = relax(System.of(scene), first_guide(scene), scene.center_of_mass_pose())
    return Pose(pose.apply(-scene.patella.center_of_mass), pose.orientation)


@Program
def _run(
    scene: Scene, start: Solution, integrator: Integrator, substeps: int | Array, energy: bool
) -> tuple[Observation, Ledger | None]:
    path = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=energy)
    return observe(scene, path), path.ledger


def settle_first_frame(scene: Scene) -> tuple[Timed, bool]:
    """The equilibrium at the first frame, and whether the damped relaxation helped to find it."""
    found = _solve.timed(scene)
    if _converged(found.answer):
        return found, False
    tried = [found, _relaxed.timed(scene)]
    if not ended_far_away(scene.start, tried[-1].answer):
        # A scene that starts there is one of the same structure: nothing is compiled again.
        tried.append(_solve.timed(eqx.tree_at(lambda s: s.start, scene, tried[-1].answer)))
    run, preparation = (sum(t[i] for t in tried) for i in (1, 2))
    helped = len(tried) > 2 and _converged(tried[-1].answer)
    return Timed((tried[-1] if helped else found).answer, run, preparation), helped


def prepare_relaxation(scene: Scene) -> None:
    """Compiles the fallback of `settle_first_frame` for scenes of this structure ahead of time."""
    _relaxed.prepare(scene.unnamed())


def _converged(solution: Solution) -> bool:
    """`Solution.converged` on the host: no program is compiled for it."""
    return bool(np.asarray(solution.residual) < tolerance_on_host(solution))


def _compiled_side_by_side(scene: Scene, integrator: Integrator, substeps: int, energy: bool) -> float:
    """Compiles both programs on two cores at once where neither is compiled yet; returns the seconds it took."""
    began = time.perf_counter()
    if _solve.at_hand(scene):
        return 0.0
    start = eqx.filter_eval_shape(start_before_search, scene)
    with ThreadPoolExecutor(1) as other:
        if (
            other.submit(jax_settings).result() != jax_settings()
        ):  # those of a `with jax.enable_x64(...)` are this thread's own
            return 0.0
        done = other.submit(_run.begin(scene, start, integrator, substeps, energy))  # the longer one
        _solve.prepare(scene)
        done.result()
    return time.perf_counter() - began


def simulate(
    scene: Scene,
    *,
    integrator: Integrator | None = None,
    dt: float | None = None,
    tolerance: str | float | None = None,
    energy_budget: bool = True,
) -> Result:
    """The patella's motion and forces through the recorded frames, starting from static equilibrium.

    Args:
        scene: what is there.
        integrator: `pftwin.LinearImplicit()` (default); `BDF2()`, of second order at the same cost (default with a
            tolerance); `Newmark()`, iterated, with options as in `Newmark(rho=0.8)`; `QuasiStatic()`, without inertia;
            `ALI3P()`, the paper's formulation in natural coordinates; `SymplecticEuler()`, explicit;
            `Diffrax("Tsit5")` and the like.
        dt: longest step [s], 1e-3 by default; the step used is the largest that divides the interval between frames.
        tolerance: instead of `dt`, how far off the path may be, such as "0.05 mm": see `pftwin.dynamics.tolerance`. The
            result's settings say which step was chosen and what error is left by estimate.
        energy_budget: keep account of work and heat at every step.

    Raises:
        InputError: a parameter of the scene, the step or the integrator that cannot give a right answer; a scene that
            is traced, by jit, grad or vmap.
    """
    refuse_traced(scene, "simulate", "trajectory")
    check(scene)
    if tolerance is not None:
        if dt is not None:
            raise InputError("found both dt and tolerance", where="simulate", expected="one of them")
        return _simulate_within_tolerance(
            scene, tolerance_in_metres(tolerance), integrator or BDF2(), bool(energy_budget)
        )
    chosen = checked_integrator(integrator or LinearImplicit(), "simulate")
    chosen.refuse_unfit(scene.effects)
    substeps = substeps_for(scene.motion.frame_interval, 1e-3 if dt is None else dt)
    plain = scene.unnamed()
    ahead = _compiled_side_by_side(plain, chosen, substeps, bool(energy_budget))
    start, relaxed = settle_first_frame(plain)
    ran = _run.timed(plain, start.answer, chosen, substeps, bool(energy_budget))
    return _result(scene, start, relaxed, ran, ahead, {"integrator": chosen.text, **_step(scene, substeps)})


def refuse_traced(scene: Scene, verb: str, pure: str) -> None:
    """Refuses a scene within a transformation, before anything is compiled.

    Raises:
        InputError: some number of the scene is traced.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        raise InputError(
            "a scene inside jit, grad, vmap or another transformation of JAX",
            where=verb,
            expected="a scene of plain numbers",
            remedy=f"pftwin.{pure}(scene), which is pure",
        )


def _simulate_within_tolerance(scene: Scene, tolerance: float, integrator: Integrator, energy: bool) -> Result:
    """Runs with the longest steps that hold a tolerance; one program serves every number of steps.

    BDF2 is the default: least work for errors between 0.3 and 0.0001 mm (docs/accuracy.md).
    """
    chosen = checked_integrator(integrator, "simulate")
    chosen.refuse_unfit(scene.effects)
    plain = scene.unnamed()
    start, relaxed = settle_first_frame(plain)
    spent = 0.0

    def run(n: int) -> tuple[Timed, Path, bool]:
        nonlocal spent
        ran = _run.timed(plain, start.answer, chosen, jnp.asarray(n), energy)
        spent += ran.preparation
        seen: Observation = ran.answer[0]
        center, turn = (np.stack([np.asarray(a, float) for a in leaves], axis=-1) for leaves in _leaves(seen))
        return ran, Path(center, turn), not (np.asarray(seen.status) & int(Status.STEP_TOO_LONG)).any()

    choice = coarsest(run, chosen.order, tolerance)
    settings = {"integrator": chosen.text, **_step(scene, choice.substeps), **settings_of(choice, tolerance)}
    return _result(scene, start, relaxed, choice.run._replace(preparation=spent), 0.0, settings)


def _leaves(seen: Observation) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    c, q = seen.center, seen.patella.orientation
    return (c.x, c.y, c.z), (q.w, q.x, q.y, q.z)


def _step(scene: Scene, substeps: int) -> dict[str, float | int]:
    return {"dt_s": scene.motion.frame_interval / substeps, "substeps": substeps}


def _result(scene: Scene, start: Timed, relaxed: bool, ran: Timed, ahead: float, settings: dict[str, Any]) -> Result:
    from pftwin.results.result import Result

    seen, ledger = ran.answer
    timing = {
        "equilibrium_s": start.run,
        "run_s": ran.run,
        "compile_s": ahead + start.preparation + ran.preparation,
    }
    return Result.build(scene, start.answer, seen, ledger, relaxed=relaxed, settings=settings, timing=timing)


def equilibrium(scene: Scene) -> EquilibriumReport:
    """The static equilibrium at the scene's first frame, nearest to its start pose, downhill.

    Returns:
        Pose, residual, which of several equilibria it is, what touches and what every effect reports there. Where the
        search fails the report says so (`converged`), it does not raise.

    Raises:
        InputError: a parameter of the scene that cannot give a right answer.
    """
    from pftwin.dynamics.equilibrium_report import EquilibriumReport

    refuse_traced(scene, "equilibrium", "trajectory")
    check(scene)
    solution, relaxed = settle_first_frame(scene.unnamed())
    return EquilibriumReport.build(scene, solution.answer, relaxed)
