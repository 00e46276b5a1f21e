"""`simulate` and `equilibrium`: the verbs of the library, on the host."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.program_cache import Program, Timed
from pftwin.base.program_cache import settings as jax_settings
from pftwin.dynamics.equilibrium import Solution, tolerance_on_host
from pftwin.dynamics.integrators import integrator_named
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.relaxation import relax, thrown
from pftwin.dynamics.status import Status
from pftwin.dynamics.tolerance import Path, coarsest, settings_of, tolerance_in_metres
from pftwin.dynamics.trajectory import (
    first_guide,
    start_before_search,
    starting_equilibrium,
    substeps_for,
    trajectory,
)
from pftwin.errors import InputError
from pftwin.scene import Scene, check
from pftwin.spatial import Pose

if TYPE_CHECKING:
    from pftwin.equilibrium_report import EquilibriumReport
    from pftwin.result import Result


@Program
def _solve(scene: Scene) -> Solution:
    return starting_equilibrium(scene)


@Program
def _relaxed(scene: Scene) -> Pose:
    pose = relax(scene.system(), first_guide(scene), scene.center_of_mass_pose())
    return Pose(pose.apply(-scene.patella.center_of_mass), pose.orientation)


@Program
def _run(
    scene: Scene, start: Solution, integrator: str, substeps: int | Array, energy: bool
) -> tuple[Observation, Ledger | None]:
    path = trajectory(scene, integrator=integrator, substeps=substeps, start=start, ledger=energy)
    return observe(scene, path), path.ledger


def settle(scene: Scene) -> tuple[Timed, bool]:
    """The equilibrium at the first frame, and whether the damped relaxation helped to find it."""
    found = _solve.timed(scene)
    if _converged(found.answer):
        return found, False
    tried = [found, _relaxed.timed(scene)]
    if not thrown(scene.start, tried[-1].answer):
        # A scene that starts there is one of the same structure: nothing is compiled again.
        tried.append(_solve.timed(eqx.tree_at(lambda s: s.start, scene, tried[-1].answer)))
    run, preparation = (sum(t[i] for t in tried) for i in (1, 2))
    helped = len(tried) > 2 and _converged(tried[-1].answer)
    return Timed((tried[-1] if helped else found).answer, run, preparation), helped


def prepare_relaxation(scene: Scene) -> None:
    """Compiles what `settle` falls back on for scenes of this kind, so that nobody has to wait for it when it does."""
    _relaxed.prepare(scene.unnamed())


def _converged(solution: Solution) -> bool:
    """`Solution.converged` on the host: no program is compiled for it."""
    return bool(np.asarray(solution.residual) < tolerance_on_host(solution))


def _compiled_side_by_side(scene: Scene, integrator: str, substeps: int, energy: bool) -> float:
    """Where both programs have to be compiled, does it on two cores at once; the seconds that it took."""
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
    integrator: str | None = None,
    dt: float | None = None,
    tolerance: str | float | None = None,
    energy_budget: bool = True,
) -> Result:
    """The patella's motion and forces through the recorded frames, starting from static equilibrium.

    Args:
        scene: what is there.
        integrator: "linear_implicit" (default); "linear_implicit_bdf2", of second order at the same cost (default with
            a tolerance); "newmark", iterated, with options as in "newmark:rho=0.8"; "quasi_static", without inertia;
            "ali3p", the paper's formulation in natural coordinates; "symplectic_euler", explicit;
            "diffrax:Tsit5" and the like.
        dt: longest step [s], 1e-3 by default; the step used is the largest that divides the interval between frames.
        tolerance: instead of `dt`, how far off the path may be, such as "0.05 mm": see `pftwin.dynamics.tolerance`. The
            result's settings say which step was chosen and what error is left by estimate.
        energy_budget: keep account of work and heat at every step.

    Raises:
        InputError: a parameter of the scene, the step or the integrator that cannot give a right answer.
    """
    check(scene)
    if tolerance is not None:
        if dt is not None:
            raise InputError("found both dt and tolerance", where="simulate", expected="one of them")
        return _within(scene, tolerance_in_metres(tolerance), integrator or ECONOMICAL, bool(energy_budget))
    name = integrator or "linear_implicit"
    integrator_named(name).fits(scene.effects)
    substeps = substeps_for(scene.motion.frame_interval, 1e-3 if dt is None else dt)
    plain = scene.unnamed()
    ahead = _compiled_side_by_side(plain, name, substeps, bool(energy_budget))
    start, relaxed = settle(plain)
    ran = _run.timed(plain, start.answer, name, substeps, bool(energy_budget))
    return _result(scene, start, relaxed, ran, ahead, {"integrator": name, **_step(scene, substeps)})


ECONOMICAL = "linear_implicit_bdf2"  # least work for an error between 0.3 and 0.0001 mm: docs/accuracy.md


def _within(scene: Scene, tolerance: float, name: str, energy: bool) -> Result:
    """With the longest steps that hold a tolerance; one program serves all of them."""
    chosen = integrator_named(name)
    chosen.fits(scene.effects)
    plain = scene.unnamed()
    start, relaxed = settle(plain)
    spent = 0.0

    def run(n: int) -> tuple[Timed, Path, bool]:
        nonlocal spent
        ran = _run.timed(plain, start.answer, name, jnp.asarray(n), energy)
        spent += ran.preparation
        seen: Observation = ran.answer[0]
        center, turn = (np.stack([np.asarray(a, float) for a in leaves], axis=-1) for leaves in _leaves(seen))
        return ran, Path(center, turn), not (np.asarray(seen.status) & int(Status.STEP_TOO_LONG)).any()

    choice = coarsest(run, chosen.order, tolerance)
    settings = {"integrator": name, **_step(scene, choice.substeps), **settings_of(choice, tolerance)}
    return _result(scene, start, relaxed, choice.run._replace(preparation=spent), 0.0, settings)


def _leaves(seen: Observation) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    c, q = seen.center, seen.patella.orientation
    return (c.x, c.y, c.z), (q.w, q.x, q.y, q.z)


def _step(scene: Scene, substeps: int) -> dict[str, float | int]:
    return {"dt_s": scene.motion.frame_interval / substeps, "substeps": substeps}


def _result(scene: Scene, start: Timed, relaxed: bool, ran: Timed, ahead: float, settings: dict[str, Any]) -> Result:
    from pftwin.result import Result

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
    from pftwin.equilibrium_report import EquilibriumReport

    check(scene)
    solution, relaxed = settle(scene.unnamed())
    return EquilibriumReport.build(scene, solution.answer, relaxed)
