"""Sensor errors that are constant throughout a recording: added to simulated ones, so posteriors allow for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fitting.nuisance import OF_SENSORS, Nuisance
from fitting.programs import ORIENTATION, POSITION, unit_of
from pftwin.base.arrays import Floats
from pftwin.files.mocap.poses import quaternion_product

if TYPE_CHECKING:
    from fitting.methods.problem import Problem
    from fitting.objective import Objective


def sensed(values: Floats, nuisance: Nuisance, problem: Problem, random: np.random.Generator) -> Floats:
    """Simulated motions (N, n, c) with sensor errors drawn for each. Scale, placement and turn are the same in all
    trials of a recording."""
    if not any(getattr(nuisance, name) for name in OF_SENSORS):
        return values
    count, out, objective = len(values), values.copy(), problem.objective
    frames = [nuisance.time_shift / scene.motion.frame_interval for scene in problem.evaluator.scenes]
    late = [share * random.standard_normal(count) for share in frames]
    turns = Rotation.from_rotvec(nuisance.turn * random.standard_normal((count, 3))) if nuisance.turn else None
    for channel, columns, _ in objective.columns():
        if channel == POSITION:
            if turns is not None:
                out[..., columns] = np.einsum("iab,inb->ina", turns.as_matrix(), out[..., columns])
            out[..., columns] += nuisance.placement * random.standard_normal((count, 1, 3))
        elif channel == ORIENTATION and turns is not None:
            out[..., columns] = quaternion_product(turns.as_quat(scalar_first=True)[:, None], out[..., columns])
        elif unit_of(channel, objective.readings) == "N":
            scale = 1 + nuisance.force_scale * random.standard_normal((count, 1, 1))
            for rows, behind in zip(objective.frames, late, strict=True):
                bias = nuisance.force_bias * random.standard_normal((count, 1, 1))
                out[:, rows, columns] = scale * _later(values[:, rows, columns], behind) + bias
    return out


def noise_beside(noise: dict[str, float], nuisance: Nuisance, objective: Objective) -> dict[str, float]:
    """Noise of each channel combined with sensor errors, rms; time shifts are judged separately."""
    found = {}
    for channel, columns, rows in objective.columns():
        own = nuisance.turn if channel == ORIENTATION else 0.0
        if channel == POSITION:
            point = objective.measured[objective.present[:, rows].all(axis=1), columns]
            # A turn moves a point by its distance from the axis: averaged over three axes, 2/3 of its square counts.
            own = np.hypot(nuisance.placement, nuisance.turn * np.sqrt(2 * np.mean(point**2)))
        elif unit_of(channel, objective.readings) == "N":
            force = objective.measured[objective.present[:, rows.start], columns]
            own = np.hypot(nuisance.force_bias, nuisance.force_scale * np.sqrt(np.mean(force**2)))
        found[channel] = float(np.hypot(noise[channel], own))
    return found


def sensors_in_words(nuisance: Nuisance) -> str:
    """The sensor errors that are not zero."""
    said = {
        f"forces read {100 * nuisance.force_scale:.3g} % too large or small": nuisance.force_scale,
        f"their zeros {nuisance.force_bias:.3g} N off": nuisance.force_bias,
        f"forces {1e3 * nuisance.time_shift:.3g} ms late or early": nuisance.time_shift,
        f"the measured point {1e3 * nuisance.placement:.3g} mm off": nuisance.placement,
        f"the femur's frame turned by {np.degrees(nuisance.turn):.3g} deg": nuisance.turn,
    }
    return ", ".join(words for words, deviation in said.items() if deviation)


def _later(signal: Floats, frames: Floats) -> Floats:
    """Signals (N, n, 1), each delayed by its number of frames (N,): interpolated linearly, constant at the ends."""
    n = signal.shape[1]
    at = np.clip(np.arange(n) - frames[:, None], 0, n - 1)
    before = np.minimum(at.astype(int), n - 2)
    share = (at - before)[..., None]
    left, right = (np.take_along_axis(signal, i[..., None], axis=1) for i in (before, before + 1))
    return (1 - share) * left + share * right
