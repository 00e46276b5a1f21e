"""`simulate` and `equilibrium`: the verbs of the library, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx

from pftwin.dynamics.equilibrium import Solution, relax
from pftwin.dynamics.observe import Observation, observe
from pftwin.dynamics.timing import timed
from pftwin.dynamics.trajectory import (
    Trajectory,
    first_guide,
    integrator_named,
    starting_equilibrium,
    substeps_for,
    trajectory,
)
from pftwin.scene import Scene, check
from pftwin.spatial import Pose

if TYPE_CHECKING:
    from pftwin.equilibrium_report import EquilibriumReport
    from pftwin.result import Result


@eqx.filter_jit
def _solve(scene: Scene, guess: Pose | None) -> Solution:
    return starting_equilibrium(scene, guess)


@eqx.filter_jit
def _relaxed(scene: Scene) -> Pose:
    pose = relax(scene.system(), first_guide(scene), scene.center_of_mass_pose())
    return Pose(pose.apply(-scene.patella.center_of_mass), pose.orientation)


@eqx.filter_jit
def _run(
    scene: Scene, start: Solution | None, integrator: str, substeps: int, energy: bool
) -> tuple[Trajectory, Observation]:
    path = trajectory(scene, integrator=integrator, substeps=substeps, start=start, ledger=energy)
    return path, observe(scene, path)


def settle(scene: Scene) -> tuple[Solution, bool]:
    """The equilibrium at the first frame, and whether the damped relaxation had to help."""
    solution = _solve(scene, None)
    if bool(solution.converged()):
        return solution, False
    return _solve(scene, _relaxed(scene)), True


def simulate(
    scene: Scene,
    *,
    integrator: str = "linear_implicit",
    dt: float = 1e-3,
    energy_budget: bool = True,
) -> Result:
    """The patella's motion and forces through the recorded frames, starting from static equilibrium.

    Args:
        scene: what is there.
        integrator: "linear_implicit" (default) or "symplectic_euler".
        dt: longest step [s]; the step used is the largest that divides the interval between two frames.
        energy_budget: keep account of work and heat at every step.

    Raises:
        InputError: a parameter of the scene, the step or the integrator that cannot give a right answer.
    """
    from pftwin.result import Result

    check(scene)
    integrator_named(integrator)
    substeps = substeps_for(scene.motion.frame_interval, dt)
    plain = scene.unnamed()
    (start, relaxed), settling, compiling_start = timed(settle, plain)
    (path, seen), running, compiling_run = timed(_run, plain, start, integrator, substeps, energy_budget)
    return Result.build(
        scene,
        path,
        seen,
        relaxed=relaxed,
        settings={"integrator": integrator, "dt_s": scene.motion.frame_interval / substeps, "substeps": substeps},
        timing={"equilibrium_s": settling, "run_s": running, "compile_s": compiling_start + compiling_run},
    )


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
    return EquilibriumReport.build(scene, solution, relaxed)
