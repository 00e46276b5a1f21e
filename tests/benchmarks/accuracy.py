"""Discretisation error: how far the path at a step lies from the same equations' converged path."""

from __future__ import annotations

import numpy as np

from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.model.scene import Scene
from tests.benchmarks.problem import Setting, compiled
from tests.benchmarks.row import Row

SUBSTEPS = (50, 20, 10, 8, 6, 5, 4, 3, 2, 1)  # of 10 ms frames: from 0.2 to 10 ms
INTEGRATORS = ("linear_implicit", "linear_implicit_bdf2")  # of equal steps the first takes less time
REFERENCE = 500  # 0.02 ms


def errors(
    scene: Scene, substeps: tuple[int, ...] = SUBSTEPS, reference: int = REFERENCE
) -> dict[str, dict[int, np.ndarray]]:
    """Distances (n_frames,) [m] of the sphere's centre to its converged place, by integrator and number of substeps.

    The converged path is BDF2's, extrapolated to a step of zero from `reference` and half as many substeps.
    """
    start = compiled(starting_equilibrium, scene)()

    def path(name: str, n: int) -> np.ndarray:
        return np.asarray(compiled(lambda s, at: Setting(name, n).path(s, at).array(), scene, start)())

    fine, coarse = (path("linear_implicit_bdf2", n) for n in (reference, reference // 2))
    converged = (4 * fine - coarse) / 3
    return {name: {n: np.linalg.norm(path(name, n) - converged, axis=1) for n in substeps} for name in INTEGRATORS}


def rms(distances: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(distances))))


def coarsest(found: dict[int, np.ndarray], level: float) -> int | None:
    """The fewest substeps from which on every finer one meets an rms level; None where the finest does not."""
    best = None
    for n in sorted(found, reverse=True):
        if not rms(found[n]) <= level:
            break
        best = n
    return best


def cheapest(found: dict[str, dict[int, np.ndarray]], level: float) -> Setting | None:
    """The integrator that meets an rms level with the fewest steps; None where none does."""
    met = [Setting(name, n) for name in INTEGRATORS if (n := coarsest(found[name], level)) is not None]
    return min(met, key=lambda setting: setting.substeps, default=None)


def rows(scene: Scene, found: dict[str, dict[int, np.ndarray]]) -> list[Row]:
    """A row per step, without targets: they say at which steps speed is measured."""
    interval = scene.motion.frame_interval
    return [
        Row(
            "accuracy",
            f"error of {name} at {1e3 * interval / n:g} ms steps, rms",
            1e3 * rms(errors[n]),
            "mm",
            note=f"largest {1e3 * float(np.max(errors[n])):.3g} mm",
            details={"substeps": n, "max_mm": 1e3 * float(np.max(errors[n]))},
        )
        for name, errors in found.items()
        for n in sorted(errors, reverse=True)
    ]
