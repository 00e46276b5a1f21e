"""What a part of a scene takes of a step's time: to be measured with and without it along one and the same path.

Every frame begins from the state of the whole scene's run there, so that a scene which would fly apart without a part
is timed where the motion is, not where it would have gone.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pftwin.base.program_cache import Program
from pftwin.base.spatial import Scalar
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.state import State, System
from pftwin.model.scene import Scene
from pftwin.studies.audit.step import frame_time, guide_over, one_step, step_length


@Program
def through_frames(scene: Scene, states: State, integrator: Integrator, substeps: int) -> Scalar:
    """All steps of a run, every frame from its own given state; a number that all of them enter."""
    system, motion = System.of(scene), scene.motion
    step = step_length(motion, substeps)

    def one_frame(index: Scalar, total: Scalar) -> Scalar:
        piece, began = motion.between_frames(index), frame_time(motion, index)

        def further(k: Scalar, state: State) -> State:
            return one_step(system, state, guide_over(piece, began + step * k.astype(float), step), step, integrator)

        end = jax.lax.fori_loop(0, substeps, further, jax.tree.map(lambda a: a[index], states))
        return total + sum(jax.tree.leaves((end.position, end.velocity, end.spin)), start=end.orientation.w)

    return jax.lax.fori_loop(0, motion.n_frames - 1, one_frame, jnp.zeros((), float))
