"""What sensors may be off by throughout a recording: drawn into simulated ones, so that posteriors allow for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fitting.nuisance import OF_SENSORS, Nuisance
from fitting.programs import ORIENTATION, POSITION, unit_of
from pftwin.base.arrays import Floats
from pftwin.files.mocap.poses import quaternion_product

if TYPE_CHECKING:
    from fitting.methods.problem import Problem
    from fitting.objective import Objective


class Sensors(NamedTuple):
    """Standard deviations of errors that stay the same for a recording, scale, placement and turn in all its trials; 0:
    there is none."""

    force_scale: float = 0.0  # of each force's sensor, as a share
    force_bias: float = 0.0  # of its zero, in each trial [N]
    time_shift: float = 0.0  # by which all forces of a trial are late [s]
    placement: float = 0.0  # of the measured point in the femur's frame, each coordinate [m]
    turn: float = 0.0  # of the femur's frame, about each axis [rad]

    @staticmethod
    def of(nuisance: Nuisance) -> Sensors:
        """Those that are part of what is not known."""
        return Sensors(**{name: getattr(nuisance, name) for name in OF_SENSORS})

    def read(self, values: Floats, problem: Problem, random: np.random.Generator) -> Floats:
        """Simulated motions (N, n, c) as such sensors would tell them."""
        if not any(self):
            return values
        count, out, objective = len(values), values.copy(), problem.objective
        frames = [self.time_shift / scene.motion.frame_interval for scene in problem.evaluator.scenes]
        late = [share * random.standard_normal(count) for share in frames]
        turns = Rotation.from_rotvec(self.turn * random.standard_normal((count, 3))) if self.turn else None
        for channel, columns, _ in objective.columns():
            if channel == POSITION:
                if turns is not None:
                    out[..., columns] = np.einsum("iab,inb->ina", turns.as_matrix(), out[..., columns])
                out[..., columns] += self.placement * random.standard_normal((count, 1, 3))
            elif channel == ORIENTATION and turns is not None:
                out[..., columns] = quaternion_product(turns.as_quat(scalar_first=True)[:, None], out[..., columns])
            elif unit_of(channel, objective.readings) == "N":
                scale = 1 + self.force_scale * random.standard_normal((count, 1, 1))
                for rows, behind in zip(objective.frames, late, strict=True):
                    bias = self.force_bias * random.standard_normal((count, 1, 1))
                    out[:, rows, columns] = scale * _later(values[:, rows, columns], behind) + bias
        return out

    def beside(self, noise: dict[str, float], objective: Objective) -> dict[str, float]:
        """Noise of each channel together with these errors, root mean square; a shift in time is judged apart."""
        found = {}
        for channel, columns, rows in objective.columns():
            own = self.turn if channel == ORIENTATION else 0.0
            if channel == POSITION:
                point = objective.measured[objective.present[:, rows].all(axis=1), columns]
                # A turn moves a point by its distance from the axis: of three axes two thirds of the square count.
                own = np.hypot(self.placement, self.turn * np.sqrt(2 * np.mean(point**2)))
            elif unit_of(channel, objective.readings) == "N":
                force = objective.measured[objective.present[:, rows.start], columns]
                own = np.hypot(self.force_bias, self.force_scale * np.sqrt(np.mean(force**2)))
            found[channel] = float(np.hypot(noise[channel], own))
        return found

    def describe(self) -> str:
        """In words, those there are."""
        said = {
            f"forces read {100 * self.force_scale:.3g} % too large or small": self.force_scale,
            f"their zeros {self.force_bias:.3g} N off": self.force_bias,
            f"forces {1e3 * self.time_shift:.3g} ms late or early": self.time_shift,
            f"the measured point {1e3 * self.placement:.3g} mm off": self.placement,
            f"the femur's frame turned by {np.degrees(self.turn):.3g} deg": self.turn,
        }
        return ", ".join(words for words, deviation in said.items() if deviation)


def _later(signal: Floats, frames: Floats) -> Floats:
    """Signals (N, n, 1), each later by its own number of frames (N,); straight between frames, held at the ends."""
    n = signal.shape[1]
    at = np.clip(np.arange(n) - frames[:, None], 0, n - 1)
    before = np.minimum(at.astype(int), n - 2)
    share = (at - before)[..., None]
    left, right = (np.take_along_axis(signal, i[..., None], axis=1) for i in (before, before + 1))
    return (1 - share) * left + share * right
