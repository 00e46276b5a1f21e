"""One step of a scene as a function of arrays: what is counted, timed and kept account of."""

from __future__ import annotations

import jax.numpy as jnp

from pftwin.base.spatial import Scalar
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.state import Guide, GuideAt, State, System
from pftwin.model.motion import KneeMotion, MotionPiece


def guide_over(piece: MotionPiece, began: Scalar, step: Scalar) -> GuideAt:
    """The guided bodies over one step that began at a time, between two recorded frames."""
    return lambda part: Guide.sample(piece, began + step * part)


def step_length(motion: KneeMotion, substeps: int) -> Scalar:
    """Of so many steps between two frames [s]."""
    return jnp.asarray(motion.frame_interval / substeps, dtype=float)


def frame_time(motion: KneeMotion, index: Scalar) -> Scalar:
    """Of a recorded frame [s]."""
    return motion.start_time + motion.frame_interval * index.astype(float)


def one_step(system: System, state: State, guide_at: GuideAt, step: Scalar, integrator: Integrator) -> State:
    """The state one step later; no account is kept."""
    return integrator.advance(system, state, guide_at, step, None)[0]
