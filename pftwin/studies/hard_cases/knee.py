"""The small knee that every case varies: a patella with its button, two tendons, weight, and a tibia that moves.

What a case changes is a number, never the structure: scenes on one kind of contact are stacked into one batch, and a
tendon that a case does without hangs slack.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.model.effects.base import Effect
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tendon import Tendon
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene
from pftwin.studies.hard_cases.ground import TiltedGround, mesh_on

Triple = tuple[float, float, float]
Floats = NDArray[np.float64]

RATE = 100.0  # [Hz]
FRAMES = 51
MASS, INERTIA = 0.12, (3e-5, 3e-5, 4e-5)
RADIUS = 0.022  # of the button [m]


@dataclass(frozen=True)
class TendonNumbers:
    """A tendon's numbers."""

    stiffness: float  # [N/m]
    slack_length: float  # [m]
    insertion: Triple  # patella frame [m]
    origin: Triple  # on its body [m]
    damping_time: float = 0.01  # damping over stiffness [s]

    def tendon(self, body: str, name: str) -> Tendon:
        """As an effect."""
        stiffness, slack = number(self.stiffness), number(self.slack_length)
        damping = number(self.damping_time * self.stiffness)
        return Tendon(stiffness, slack, damping, vector(self.insertion), vector(self.origin), body, name=name)


@dataclass(frozen=True)
class Law:
    """A contact law's numbers (Flores et al. 2011); the exponent is one of them, so that it can be varied."""

    stiffness: float = 2e8  # [N/m^p]
    exponent: float = 1.5
    restitution: float = 0.6
    floor: float = 0.01  # of the approach speed [m/s]

    def flores(self) -> Flores:
        """As a law."""
        stiffness, exponent = number(self.stiffness), number(self.exponent)
        restitution, floor = number(self.restitution), number(self.floor)
        return Flores(stiffness, restitution, hertz_exponent=exponent, approach_speed_floor=floor)


def flexed(degrees: Floats, positions: Floats | None = None) -> PoseSeries:
    """The tibia's poses in the femur at angles of flexion (n,), about the femur's origin, at `RATE`."""
    half = np.radians(degrees) / 2
    zero = 0.0 * half
    turns = np.stack([np.cos(half), zero, -np.sin(half), zero], axis=1)
    times = np.arange(half.size) / RATE
    return PoseSeries(times, np.zeros((half.size, 3)) if positions is None else positions, turns, source="tibia")


def flexion(n: int, speed: float = 1.0) -> Floats:
    """(n,) From 45 to 65 deg and back in 0.9 s, at another speed in as much less [deg]."""
    return 45 + 20 * np.sin(2 * np.pi * speed * np.arange(n) / RATE / 1.8) ** 2


def swinging(n: int = FRAMES, speed: float = 1.0) -> PoseSeries:
    """A tibia of that flexion."""
    return flexed(flexion(n, speed))


def standing(n: int = FRAMES) -> PoseSeries:
    """45 deg of flexion throughout."""
    return flexed(np.full(n, 45.0))


QUADRICEPS = TendonNumbers(156, 0.1432, (0.02, 0, -0.008), (0.22, 0.012, 0.035))
PATELLAR_TENDON = TendonNumbers(629, 0.0714, (-0.02, 0, -0.008), (-0.07, 0.01, 0.045))


def _trochlea(u: Floats, v: Floats) -> Floats:
    """A groove around the distal femur, about a trochlear radius of 26 mm."""
    return np.sqrt(0.026**2 - (0.85 * u) ** 2) - 0.026 + np.sqrt(v**2 + 0.006**2) * np.tan(np.radians(18))


TROCHLEA = TiltedGround(_trochlea, tilt=float(np.radians(40)), above=0.026)


@dataclass(frozen=True)
class KneeNumbers:
    """All numbers of a scene."""

    ground: TiltedGround = TROCHLEA
    law: Law = Law()
    radius: float = RADIUS
    center: Triple = (0.0, 0.0, 0.0)  # of the button, patella frame [m]
    mass: float = MASS
    center_of_mass: Triple = (0.001, 0.0, 0.004)
    gravity: Triple = (0.0, 0.0, -9.81)  # femur axes [m/s^2]
    quadriceps: TendonNumbers = QUADRICEPS
    patellar_tendon: TendonNumbers = PATELLAR_TENDON
    tibia: Callable[[], PoseSeries] = field(default=swinging)
    start: Triple = (-0.005, 0.001, 0.05)
    turn: Triple = (0.0, 0.0, 0.0)  # of the start, a rotation vector [rad]
    mesh: Callable[[TiltedGround], SurfaceMesh] = mesh_on  # the femur's, where contact is between meshes
    facets: int = 2  # of that mesh

    def scene(self, contact: Effect, name: str) -> Scene:
        """The scene with a contact that was made for it.

        Raises:
            InputError: numbers, a motion or a surface that cannot be.
        """
        inertia = tuple(i * self.mass / MASS for i in INERTIA)
        effects = (
            Gravity(number(self.mass), vector(self.gravity)),
            self.quadriceps.tendon("femur", "quadriceps"),
            self.patellar_tendon.tendon("tibia", "patellar_tendon"),
            contact,
        )
        turn = Quaternion.from_rotation_vector(vector(self.turn))
        body = PatellaBody(number(self.mass), vector(inertia), vector(self.center_of_mass))
        motion = KneeMotion.from_poses(None, self.tibia())
        return Scene(body, effects, motion, Pose(vector(self.start), turn), name, synthetic=True)
