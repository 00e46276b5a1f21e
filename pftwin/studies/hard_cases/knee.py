"""The small knee that the cases vary: a patella with its button, two tendons, weight, and a moving tibia.

Cases change parameters but not the structure, because scenes with one kind of contact are stacked into one batch. A
tendon that a case lacks is always slack.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.polynomial import exponents
from pftwin.model.effects.contact_law import Flores
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.tendon import Tendon
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import PatellaBody, Scene
from pftwin.studies.hard_cases.contacts import contact_on
from pftwin.studies.hard_cases.ground import TROCHLEA, TiltedGround, axis_below, mesh_on

Triple = tuple[float, float, float]

RATE = 100.0  # [Hz]
FRAMES = 51
MASS, INERTIA = 0.12, (3e-5, 3e-5, 4e-5)
RADIUS = 0.022  # of the button [m]


@dataclass(frozen=True)
class TendonNumbers:
    """Parameters of a tendon."""

    stiffness: float  # [N/m]
    slack_length: float  # [m]
    insertion: Triple  # patella frame [m]
    origin: Triple  # frame of the other body [m]
    damping_time: float = 0.01  # damping over stiffness [s]

    def tendon(self, body: str, name: str) -> Tendon:
        """Returns the tendon as an effect."""
        given = self.stiffness, self.slack_length, self.damping_time * self.stiffness
        stiffness, slack, damping = map(number, given)
        return Tendon(stiffness, slack, damping, vector(self.insertion), vector(self.origin), body, name=name)


@dataclass(frozen=True)
class Law:
    """Parameters of a contact law (Flores et al. 2011), with a variable exponent."""

    stiffness: float = 2e8  # [N/m^p]
    exponent: float = 1.5
    restitution: float = 0.6
    floor: float = 0.01  # of the approach speed [m/s]

    def flores(self) -> Flores:
        """Returns the contact law."""
        exponent, floor = number(self.exponent), number(self.floor)
        stiffness, restitution = number(self.stiffness), number(self.restitution)
        return Flores(stiffness, restitution, hertz_exponent=exponent, approach_speed_floor=floor)


def flexed(degrees: Floats, positions: Floats | None = None) -> PoseSeries:
    """Returns the tibia's poses in the femur for flexion angles (n,) [deg] about the femur's origin, at `RATE`."""
    half = np.radians(degrees) / 2
    zero = 0.0 * half
    turns = np.stack([np.cos(half), zero, -np.sin(half), zero], axis=1)
    times = np.arange(half.size) / RATE
    return PoseSeries(times, np.zeros((half.size, 3)) if positions is None else positions, turns, source="tibia")


def flexion(n: int, speed: float = 1.0) -> Floats:
    """Returns flexion (n,) [deg] from 45 to 65 deg and back in 0.9 s at speed 1."""
    return 45 + 20 * np.sin(2 * np.pi * speed * np.arange(n) / RATE / 1.8) ** 2


def swinging(n: int = FRAMES, speed: float = 1.0) -> PoseSeries:
    """Returns the motion of a tibia with that flexion."""
    return flexed(flexion(n, speed))


def standing() -> PoseSeries:
    """Returns the motion of a tibia at rest at 45 deg of flexion."""
    return flexed(np.full(FRAMES, 45.0))


QUADRICEPS = TendonNumbers(156, 0.1432, (0.02, 0, -0.008), (0.22, 0.012, 0.035))
PATELLAR_TENDON = TendonNumbers(629, 0.0714, (-0.02, 0, -0.008), (-0.07, 0.01, 0.045))


@dataclass(frozen=True)
class KneeNumbers:
    """All parameters of a scene (SI units)."""

    ground: TiltedGround = TROCHLEA
    law: Law = Law()
    radius: float = RADIUS  # of the button [m]
    center: Triple = (0.0, 0.0, 0.0)  # of the button, patella frame [m]
    mass: float = MASS  # of the patella [kg]
    center_of_mass: Triple = (0.001, 0.0, 0.004)  # patella frame [m]
    gravity: Triple = (0.0, 0.0, -9.81)  # femur axes [m/s^2]
    quadriceps: TendonNumbers = QUADRICEPS
    patellar_tendon: TendonNumbers = PATELLAR_TENDON
    tibia: Callable[[], PoseSeries] = field(default=swinging)
    start: Triple = (-0.005, 0.001, 0.05)  # starting position of the patella, femur frame [m]
    turn: Triple = (0.0, 0.0, 0.0)  # rotation vector of the starting orientation [rad]
    mesh: Callable[[TiltedGround], SurfaceMesh] = mesh_on  # makes the femur's mesh for contact between meshes
    facets: int = 2  # of that mesh

    def scene_on(self, kind: str, name: str) -> Scene:
        """Builds the scene with a kind of contact; InputError for invalid parameters, motion or surface."""
        inertia = tuple(i * self.mass / MASS for i in INERTIA)
        effects = (
            Gravity(number(self.mass), vector(self.gravity)),
            self.quadriceps.tendon("femur", "quadriceps"),
            self.patellar_tendon.tendon("tibia", "patellar_tendon"),
            contact_on(self, kind),
        )
        turn = Quaternion.from_rotation_vector(vector(self.turn))
        body = PatellaBody(number(self.mass), vector(inertia), vector(self.center_of_mass))
        motion = KneeMotion.from_poses(None, self.tibia())
        return Scene(body, effects, motion, Pose(vector(self.start), turn), name, synthetic=True)

    def axis_below(self, kind: str) -> float:
        """Returns the depth of a cylindrical patch's axis below the ground [m]; 0 for other contacts."""
        return axis_below(self.ground, kind)


_NOISE = (0.5e-3, 0.3)  # of positions [m] and of flexion [deg], standard deviations
_LONG = 60.0  # [s]


def _jumping() -> PoseSeries:
    """One frame is displaced by 20 mm and 15 deg, as if two markers were swapped."""
    angles, positions = flexion(FRAMES), np.zeros((FRAMES, 3))
    angles[25] += 15
    positions[25] = (0.0, 0.02, 0.0)
    return flexed(angles, positions)


def _noisy() -> PoseSeries:
    random = np.random.default_rng(7)
    positions = random.normal(0, _NOISE[0], (FRAMES, 3))
    return flexed(flexion(FRAMES) + random.normal(0, _NOISE[1], FRAMES), positions)


def _with(**changes: Callable[[Floats], Floats]) -> Callable[[], PoseSeries]:
    """A function that makes the plain motion with changed times, positions or quaternions."""

    def made() -> PoseSeries:
        original, same = swinging(), lambda a: a
        arrays = (changes.get(n, same)(getattr(original, n)) for n in ("times", "positions", "quaternions"))
        return PoseSeries(*arrays, source="tibia")

    return made


_frame = np.arange(FRAMES)
MOTIONS: Mapping[str, Callable[[], PoseSeries]] = {
    "standing": standing,
    "swinging": swinging,
    "jumping": _jumping,
    "noisy": _noisy,
    "signs_flip": _with(quaternions=lambda q: np.where(_frame % 3 == 1, -1.0, 1.0)[:, None] * q),
    "all_negative": _with(quaternions=lambda q: -q),
    "ten_times_faster": lambda: swinging(speed=10.0),
    "long": lambda: swinging(round(_LONG * RATE) + 1),
    "three_frames": lambda: flexed(np.full(3, 45.0)),
    "uneven": _with(times=lambda t: np.where(_frame < 20, t, t + 0.02)),
    "not_finite": _with(positions=lambda x: np.where(_frame[:, None] == 3, np.nan, x)),
    "not_unit": _with(quaternions=lambda q: 1.1 * q),
}


DEGREE, BUMPS = 5, 4e-4  # degree of the bumps added to the trochlea; standard deviation of their coefficients [m]


def bumpy(coefficients: np.ndarray) -> TiltedGround:
    """Returns the trochlea with a polynomial of `DEGREE`, in coordinates from -1 to 1, added to its height [m]."""
    half, powers = TROCHLEA.half, exponents(DEGREE)

    def height(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        a, b = u / half[0], v / half[1]
        return TROCHLEA.height(u, v) + sum(c * a**i * b**j for c, (i, j) in zip(coefficients, powers, strict=True))

    return replace(TROCHLEA, height=height)


def drawn(seed: int) -> KneeNumbers:
    """Returns a random knee, with all parameters in the range of the catalogue."""
    random = np.random.default_rng(seed)
    quadriceps, tendon = (
        replace(
            s, stiffness=s.stiffness * random.uniform(0.5, 2.0), slack_length=s.slack_length * random.uniform(0.9, 1.02)
        )
        for s in (QUADRICEPS, PATELLAR_TENDON)
    )
    law = Law(10 ** random.uniform(7.5, 9.5), random.uniform(1.3, 1.7), random.uniform(0.1, 1.0))
    ground = bumpy(random.normal(0, BUMPS, len(exponents(DEGREE))))
    mass = float(10 ** random.uniform(-1.5, -0.5))
    return KneeNumbers(ground=ground, law=law, mass=mass, quadriceps=quadriceps, patellar_tendon=tendon)
