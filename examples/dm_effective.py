"""Sixty strands and four muscles of the DM recording, replaced by two elastic tendons with a width.

Attachments come from the recorded geometry, weighted by the recorded tensions; stiffness and slack length do not:
`examples/dm_patient.py` fits them to the recorded poses. `reference` says what they would be if they were taken from
the recorded tensions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from dm_knee import Knee, array, vec3
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar, Vec3
from pftwin.files.mocap import PoseSeries
from pftwin.model.effects.base import Instant, Load
from pftwin.model.effects.tendon import StrandGroup, Tendon
from pftwin.model.effects.tension import PrescribedTension
from pftwin.model.scene import Scene

Floats = NDArray[np.float64]

QUADRICEPS, PATELLAR_TENDON = "quadriceps", "patellar_tendon"
STIFFNESS = {QUADRICEPS: 3e3, PATELLAR_TENDON: 1e5}  # a guess to start from [N/m]
FIRST_PULL = 20.0  # a guess too: of either tendon at the first frame, some four times the patella's weight [N]
DAMPING_TIME = 0.01  # damping per stiffness, as the paper's springs have it [s]


class Band(Tendon):
    """A tendon with a width: half of it runs to either side of its middle line, medially and laterally.

    Both halves share stiffness and slack length, so the band has the parameters of a tendon, and its tension is the sum
    of theirs. A single line does not resist turning about itself: through attachments that lie in one line with the
    button's centre, as here, it leaves the patella's tilt to chance. A band of length L and half widths b and B at its
    ends resists a small turn a by the moment tension * b B / L * a.
    """

    insertion_half_width: Scalar  # along y of the patella [m]
    origin_half_width: Scalar  # along y of the guided body [m]

    def halves(self) -> Tendon:
        """The two lines as a group."""
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
        """The pull of both halves."""
        return self.halves().load(now, memory)

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Tension of the whole band, and its mean length."""
        seen = self.halves().observe(now, memory)
        return {"tension": jnp.sum(seen["tension"]), "length": jnp.mean(seen["length"])}


@dataclass(frozen=True)
class Course:
    """Where a tendon attaches, and half its width there: effective values of many recorded lines."""

    origin: Floats  # (3,) on the guided body, its frame [m]
    insertion: Floats  # (3,) on the patella, its frame [m]
    origin_half_width: float  # rms distance of the lines from the middle, medial-lateral [m]
    insertion_half_width: float
    length: Floats  # (n,) from origin to insertion at the recorded poses [m]


def courses(knee: Knee) -> dict[str, Course]:
    """The effective quadriceps and patellar tendon of the recording.

    The patellar tendon: its strands' ends, weighted by the tensions that its strands have at the recorded poses. The
    quadriceps: the muscles' insertions likewise; its origin is the point to which the recorded pulls point most nearly.
    The mean of the last points on the femur will not do: muscles that run 100 to 460 mm up the thigh end 20 mm away
    once they wrap, and a line to their mean pulls backward in deep flexion where the muscles pull forward.
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
    """The scene with two elastic tendons of guessed stiffness; motion, patella, gravity and contact as they were.

    Args:
        knee: of `dm_knee.build`.
        found: of `courses`.
        bands: whether the tendons have their width; single lines else.
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
    return Scene(knee.scene.patella, (*tendons, *kept), knee.scene.motion, knee.scene.start, name="DM patient")


def reference(knee: Knee, found: dict[str, Course]) -> dict[str, float]:
    """K1, L1, K2, L2 [N/m, m] as a straight line through the recorded tensions over the recorded lengths has them.

    No fit sees them: they are what fits are compared with.
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
    """A body's points (m, 3) in the femur at every frame (n, m, 3)."""
    return poses.positions[:, None] + np.einsum("nij,mj->nmi", poses.matrices(), points)


def _lengths(knee: Knee, body: PoseSeries | None, origin: Floats, insertion: Floats) -> Floats:
    begin = origin if body is None else _moved(body, origin[None])[:, 0]
    return np.linalg.norm(_moved(knee.patella, insertion[None])[:, 0] - begin, axis=-1)


def _toward(through: Floats, force: Floats, guess: Floats) -> Floats:
    """The point (3,) to which lines through points (n, 3) run most nearly along forces (n, 3), large ones above all."""
    size = np.linalg.norm(force, axis=1, keepdims=True)

    def missed(point: Floats) -> Floats:
        line = point - through
        return (np.sqrt(size) * (line / np.linalg.norm(line, axis=1, keepdims=True) - force / size)).ravel()

    return least_squares(missed, guess, x_scale=0.01).x


def _strand_tensions(knee: Knee, strands: StrandGroup) -> Floats:
    """(n, m) [N] of every strand at rest at the recorded poses, by the law that `StrandGroup` states."""
    line = _moved(knee.tibia, _points(strands.origin)) - _moved(knee.patella, _points(strands.insertion))
    slack, toe, k = (np.asarray(a) for a in (strands.slack_length, strands.toe_strain, strands.stiffness))
    strain = np.maximum(np.linalg.norm(line, axis=-1) / slack - 1, 0.0)
    return k * np.where(strain < toe, strain**2 / (2 * toe), strain - toe / 2)


__all__ = ["Band", "Course", "courses", "patient", "reference"]
