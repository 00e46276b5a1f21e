"""Discretisation error: how far the path at a step lies from the same equations' converged path."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.model.scene import Scene
from tests.benchmarks.problem import compiled, tracked_path
from tests.benchmarks.row import Row

SUBSTEPS = (50, 20, 10, 8, 6, 5, 4, 3, 2, 1)  # of 10 ms frames: from 0.2 to 10 ms
LEVELS = (1e-5, 5e-5)  # rms [m]
REFERENCE = 500  # 0.02 ms


def errors(scene: Scene, substeps: tuple[int, ...] = SUBSTEPS, reference: int = REFERENCE) -> dict[int, np.ndarray]:
    """Distances (n_frames,) [m] of the sphere's centre to its converged place, by number of substeps.

    The converged path is extrapolated to a step of zero from `reference` and half as many substeps (order two).
    """
    start = compiled(starting_equilibrium, scene)()

    def path(n: int) -> np.ndarray:
        return np.asarray(compiled(lambda s, at: tracked_path(s, substeps=n, start=at).array(), scene, start)())

    fine = path(reference)
    converged = (4 * fine - path(reference // 2)) / 3
    return {n: np.linalg.norm(path(n) - converged, axis=1) for n in substeps}


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


def rows(scene: Scene, found: dict[int, np.ndarray]) -> list[Row]:
    """A row per step, without targets: they say at which steps speed is measured."""
    interval = scene.motion.frame_interval
    return [
        Row(
            "accuracy",
            f"error at {1e3 * interval / n:g} ms steps, rms",
            1e3 * rms(found[n]),
            "mm",
            note=f"largest {1e3 * float(jnp.max(found[n])):.3g} mm",
            details={"substeps": n, "max_mm": 1e3 * float(np.max(found[n]))},
        )
        for n in sorted(found, reverse=True)
    ]
