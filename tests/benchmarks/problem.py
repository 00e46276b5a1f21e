"""What is measured: case 1 of the rig with P5, as compiled functions of its arrays.

Whatever is no array (a Hertz exponent given as a Python number) stays fixed while tracing, as in `pftwin.simulate`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import tracked_center
from pftwin.model.effects.tendon import Tendon
from pftwin.model.scene import Scene

SPRINGS = ("quadriceps", "patellar_tendon")
SPREAD = 0.10  # of each spring parameter, to either side


def scene_of_case_1() -> Scene:
    """The scene that all figures are for."""
    import pftwin

    return pftwin.rig.case(1, contact="P5")


def duration(scene: Scene) -> float:
    """Length of the recorded motion: what "real time" is [s]."""
    return scene.motion.end_time - scene.motion.start_time


def compiled(function: Callable[..., Any], scene: Scene, *args: Any) -> Callable[[], Any]:
    """A call of function(scene, *args) whose first run compiles; of the scene, only arrays are traced."""
    arrays, fixed = eqx.partition(scene, eqx.is_array)
    jitted = jax.jit(lambda a, *rest: function(eqx.combine(a, fixed), *rest))
    return lambda: jitted(arrays, *args)


def temporary_memory(function: Callable[..., Any], scene: Scene, *args: Any) -> int | None:
    """Bytes that the compiled function needs besides its arguments and results; None where XLA does not say."""
    arrays, fixed = eqx.partition(scene, eqx.is_array)
    lowered = jax.jit(lambda a, *rest: function(eqx.combine(a, fixed), *rest)).lower(arrays, *args)
    analysis = lowered.compile().memory_analysis()
    return None if analysis is None else int(analysis.temp_size_in_bytes)


def with_springs(scene: Scene, factors: Array) -> Scene:
    """The scene with K1, L1, K2, L2 multiplied by factors of shape (4,)."""
    for i, name in enumerate(SPRINGS):
        spring = scene.effect(name)
        assert isinstance(spring, Tendon)
        changed = spring.stiffness * factors[2 * i], spring.slack_length * factors[2 * i + 1]
        scene = scene.with_effect(eqx.tree_at(lambda s: (s.stiffness, s.slack_length), spring, changed))
    return scene


def variants(count: int) -> Array:
    """Factors (count, 4) for K1, L1, K2, L2, uniform within +-10 %."""
    return jnp.asarray(np.random.default_rng(1).uniform(1 - SPREAD, 1 + SPREAD, (count, 4)), dtype=float)


def started_nearby(scene: Scene) -> Scene:
    """The scene with its own equilibrium as the start pose: where a study of its variants begins each search."""
    arrays, fixed = eqx.partition(scene, eqx.is_array)

    def settle(a: Any) -> Any:
        here = eqx.combine(a, fixed)
        pose = starting_equilibrium(here).pose
        return eqx.tree_at(lambda p: p.position, pose, pose.apply(-here.patella.center_of_mass))

    return eqx.tree_at(lambda s: s.start, scene, jax.jit(settle)(arrays))


class Setting(NamedTuple):
    """An integrator by its name, and how many steps it takes between two frames: plain data for other processes."""

    integrator: str
    substeps: int

    def path(self, scene: Scene, start: Solution | None = None) -> Vec3:
        """See `tracked_path`."""
        integrator = integrator_from_text(self.integrator)
        return tracked_path(scene, integrator=integrator, substeps=self.substeps, start=start)

    def words(self, scene: Scene) -> str:
        """For a row's note."""
        return f"{self.integrator}, {1e3 * scene.motion.frame_interval / self.substeps:.3g} ms steps"


def tracked_path(
    scene: Scene, *, integrator: Integrator | None = None, substeps: int | Scalar = 10, start: Solution | None = None
) -> Vec3:
    """The tracked point's path alone, femur frame (n_frames,) [m]; by default with what `tolerance=` takes."""
    path = frame_states(scene, integrator=integrator or BDF2(), substeps=substeps, start=start)
    return tracked_center(scene, path.states)
