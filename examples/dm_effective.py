"""Two elastic tendons with a width that replace the sixty strands and four muscles of the DM recording.

Attachments come from the recorded geometry, weighted by the recorded tensions. Stiffness and slack length are fitted to
the recorded poses by `examples/dm_patient.py`; `reference` computes them from the recorded tensions, for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from dm_knee import Knee, array, vec3
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pftwin import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.mocap import PoseSeries
from pftwin.model.effects import Instant, Load, PrescribedTension, StrandGroup, Tendon
from pftwin.model.scene import Scene

Floats = NDArray[np.float64]

QUADRICEPS, PATELLAR_TENDON = "quadriceps", "patellar_tendon"
STIFFNESS = {QUADRICEPS: 3e3, PATELLAR_TENDON: 1e5}  # initial guess [N/m]
FIRST_PULL = 20.0  # initial guess of each tension at the first frame, about four times the patella's weight [N]
DAMPING_TIME = 0.01  # damping over stiffness, as for the paper's springs [s]


class Band(Tendon):
    """A tendon with a width: one half on the medial and one on the lateral side of its middle line.

    Both halves share stiffness and slack length, so the band has the parameters of a tendon, and its tension is their
    sum. A single line does not resist rotation about itself: if its attachments are in line with the button's centre,
    as here, the patella's tilt is undetermined. A band of length L and half widths b and B at its ends resists a small
    rotation a by the moment tension * b B / L * a.
    """

    insertion_half_width: Scalar  # along y of the patella [m]
    origin_half_width: Scalar  # along y of the other body [m]

    def halves(self) -> Tendon:
        """Returns the two lines as a group."""
        side, both = jnp.asarray([-1.0, 1.0]), jnp.ones(2)

        def apart(p: Vec3, half_width: Scalar) -> Vec3:
            return Vec3(p.x * both, p.y + half_width * side, p.z * both)

        return Tendon(
            0.5 * self.stiffness * both,
            self.slack_length * both,
            0.5 * self.damping * both,
            apart(self.insertion, self.insertion_half_width),
            apart(self.origin, self.origin_half_width),
            self.body,
            name=self.name,
        )

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Returns the load of both halves."""
        return self.halves().load(now, memory)

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Returns the tension of the whole band [N] and its mean length [m]."""
        seen = self.halves().observe(now, memory)
        return {"tension": jnp.sum(seen["tension"]), "length": jnp.mean(seen["length"])}


@dataclass(frozen=True)
class Course:
    """Effective attachments and half widths of a tendon, from many recorded lines."""

    origin: Floats  # (3,) in the frame of the other body [m]
    insertion: Floats  # (3,) in the patella's frame [m]
    origin_half_width: float  # rms distance of the lines from the middle, medial-lateral [m]
    insertion_half_width: float
    length: Floats  # (n,) from origin to insertion at the recorded poses [m]


def courses(knee: Knee) -> dict[str, Course]:
    """Computes the effective quadriceps and patellar tendon of the recording.

    Patellar tendon: mean of its strands' ends, weighted by the tensions of the strands at the recorded poses.
    Quadriceps: the muscles' insertions in the same way; its origin is the point that best fits the recorded directions.
    The mean of the last points on the femur is not suitable: muscles that run 100 to 460 mm up the thigh end 20 mm away
    once they wrap, and a line to that mean pulls backward in deep flexion, where the muscles pull forward.
    """
    muscles, strands = knee.scene.effect("quadriceps"), knee.scene.effect("pt")
    if not (isinstance(muscles, PrescribedTension) and isinstance(strands, StrandGroup)):
        raise InputError("no recorded muscles and strands", where=knee.scene.name, expected="dm_knee.build's scene")
    pull, last, insertion = np.asarray(muscles.tension), _points(muscles.origin), _points(muscles.insertion)
    middle, width = _middle(insertion, pull)
    ends = _moved(knee.patella, insertion)
    along = (last - ends) / np.linalg.norm(last - ends, axis=-1, keepdims=True)
    force = np.einsum("nm,nmi->ni", pull, along)
    mean_last, origin_width = _middle(last, pull)
    origin = _toward(_moved(knee.patella, middle[None])[:, 0], force, mean_last)
    quadriceps = Course(origin, middle, origin_width, width, _lengths(knee, None, origin, middle))

    ends, begins = _points(strands.insertion), _points(strands.origin)
    tension = _strand_tensions(knee, strands)
    (end, width), (begin, begin_width) = _middle(ends, tension), _middle(begins, tension)
    tendon = Course(begin, end, begin_width, width, _lengths(knee, knee.tibia, begin, end))
    return {QUADRICEPS: quadriceps, PATELLAR_TENDON: tendon}


def patient(knee: Knee, found: dict[str, Course], *, bands: bool = True) -> Scene:
    """Returns the scene with two elastic tendons of guessed stiffness; motion, patella, gravity and contact are kept.

    Args:
        knee: result of `dm_knee.build`.
        found: result of `courses`.
        bands: whether the tendons have a width; otherwise they are single lines.
    """
    tendons = []
    for name, body in ((QUADRICEPS, "femur"), (PATELLAR_TENDON, "tibia")):
        c, stiffness = found[name], STIFFNESS[name]
        line = (
            array(stiffness),
            array(c.length[0] - FIRST_PULL / stiffness),
            array(DAMPING_TIME * stiffness),
            vec3(c.insertion),
            vec3(c.origin),
            body,
        )
        widths = array(c.insertion_half_width), array(c.origin_half_width)
        tendons.append(Band(*line, *widths, name=name) if bands else Tendon(*line, name=name))
    kept = (knee.scene.effect("gravity"), knee.scene.effect("contact"))
    return replace(knee.scene, effects=(*tendons, *kept), name="DM patient")


def reference(knee: Knee, found: dict[str, Course]) -> dict[str, float]:
    """Returns K1, L1, K2, L2 [N/m, m] from a straight-line fit of recorded tension over recorded length.

    The fits to poses do not use them; they are only compared with them.
    """
    out = {}
    for i, name in enumerate((QUADRICEPS, PATELLAR_TENDON), 1):
        slope, constant = np.polyfit(found[name].length, knee.tensions.column(name), 1)
        out |= {f"K{i}": float(slope), f"L{i}": float(-constant / slope)}
    return out


def _points(p: Vec3) -> Floats:
    return np.asarray(p.array(), dtype=np.float64)


def _middle(points: Floats, weights: Floats) -> tuple[Floats, float]:
    """Weighted mean of points ([n,] m, 3) with weights (n, m), and their rms distance from it along y in a frame."""
    points = np.broadcast_to(points, (*weights.shape, 3))
    here = np.einsum("nm,nmi->ni", weights, points) / weights.sum(axis=1)[:, None]
    spread = np.sum(weights * (points - here[:, None])[..., 1] ** 2) / weights.sum()
    return np.einsum("nm,nmi->i", weights, points) / weights.sum(), float(np.sqrt(spread))


def _moved(poses: PoseSeries, points: Floats) -> Floats:
    """A body's points (m, 3) in the femur frame at every frame (n, m, 3) [m]."""
    return poses.positions[:, None] + np.einsum("nij,mj->nmi", poses.matrices(), points)


def _lengths(knee: Knee, body: PoseSeries | None, origin: Floats, insertion: Floats) -> Floats:
    begin = origin if body is None else _moved(body, origin[None])[:, 0]
    return np.linalg.norm(_moved(knee.patella, insertion[None])[:, 0] - begin, axis=-1)


def _toward(through: Floats, force: Floats, guess: Floats) -> Floats:
    """The point (3,) for which lines from points (n, 3) fit the directions of forces (n, 3) best, weighted by force."""
    size = np.linalg.norm(force, axis=1, keepdims=True)

    def missed(point: Floats) -> Floats:
        line = point - through
        return (np.sqrt(size) * (line / np.linalg.norm(line, axis=1, keepdims=True) - force / size)).ravel()

    return least_squares(missed, guess, x_scale=0.01).x


def _strand_tensions(knee: Knee, strands: StrandGroup) -> Floats:
    """Static tension (n, m) [N] of every strand at the recorded poses, by the law of `StrandGroup`."""
    line = _moved(knee.tibia, _points(strands.origin)) - _moved(knee.patella, _points(strands.insertion))
    slack, toe, k = (np.asarray(a) for a in (strands.slack_length, strands.toe_strain, strands.stiffness))
    strain = np.maximum(np.linalg.norm(line, axis=-1) / slack - 1, 0.0)
    return k * np.where(strain < toe, strain**2 / (2 * toe), strain - toe / 2)


__all__ = ["Band", "Course", "courses", "patient", "reference"]
