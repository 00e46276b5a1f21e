"""The plant that the virtual laboratory measures: a separate mechanical model in NumPy and SciPy, without twin code.

It shares with the twin the parameters of the rig (`pftwin.rig.geometry`) and of the implant's shape, and the common
assumptions: one rigid patella, straight springs, a sphere with an indentation law, bones with prescribed motion. It
differs on purpose: the true smooth implant instead of a polynomial, a memoryless contact law, a little friction,
stiffening springs, attachments displaced by about a millimetre, other drag and another integrator. SI units, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from pftwin.rig import geometry as rig
from tests.verification.rig_plant.plant_contact import ImplantContact
from tests.verification.rig_plant.plant_parts import Frame, GuidedBones, Spring, cross, matrix, product

FRICTION = 0.02  # coefficient of the lubricated contact
STICTION_SPEED = 2e-3  # slip speed below which friction fades to zero [m/s]
DISSIPATION = 1.0  # alpha of the contact law [s/m]
DRAG = 1.1 * rig.DRAG[0], 0.9 * rig.DRAG[1]  # [N s/m, N m s/rad]
TOLERANCE = 1e-8  # of the integrator, relative and absolute
BUTTON = -np.array(rig.CENTER_OF_MASS)  # centre of the button's sphere relative to the centre of mass [m]
START = np.array([5e-3, 0.0, 49.3e-3])  # approximate starting position of that centre in the femur frame [m]


class Forces(NamedTuple):
    """Forces on the patella at one time."""

    force: NDArray  # total force, world axes [N]
    moment: NDArray  # total moment about the centre of mass, world axes [N m]
    pulls: list[float]  # tensions of the springs [N]
    contact: float  # sum of the normal forces [N]


@dataclass
class Plant:
    """A patella on one spring from the femur and one from the tibia, with its button on the femoral implant.

    The state (13,) is the position of the centre of mass, the quaternion from patella to world, the velocity in world
    axes and the angular velocity in patella axes.
    """

    bones: GuidedBones
    springs: tuple[Spring, ...]  # from the femur and from the tibia
    contact: ImplantContact
    drag: tuple[float, float] = DRAG
    friction: float = FRICTION
    dissipation: float = DISSIPATION

    def forces(self, patella: Frame, femur: Frame, tibia: Frame) -> Forces:
        """Sums weight, drag relative to the femur, springs, contact and friction."""
        force = rig.MASS * np.array(rig.GRAVITY)
        force = force - self.drag[0] * (patella.velocity - femur.velocity_at(patella.origin))
        moment = -self.drag[1] * (patella.spin - femur.spin)
        pulls = []
        for spring, bone in zip(self.springs, (femur, tibia), strict=True):
            (end, v), (origin, w) = patella.point(spring.insertion), bone.point(spring.origin)
            length = float(np.sqrt((origin - end) @ (origin - end)))
            along = (origin - end) / length
            pulls.append(spring.force(length, float(along @ (w - v))))
            force, moment = force + pulls[-1] * along, moment + pulls[-1] * cross(end - patella.origin, along)
        (centre, v), total = patella.point(BUTTON), 0.0
        closing = femur.velocity_at(centre) - v
        for place in self.contact.stationary(femur.turn.T @ (centre - femur.origin)):
            normal = femur.turn @ place.normal
            size = place.sign * self.normal_force(rig.BUTTON_RADIUS - place.distance, float(normal @ closing))
            skin = centre - rig.BUTTON_RADIUS * normal
            slip = patella.velocity_at(skin) - femur.velocity_at(skin)
            slip = slip - (slip @ normal) * normal
            push = size * (normal - self.friction / np.sqrt(slip @ slip + STICTION_SPEED**2) * slip)
            total, force, moment = total + size, force + push, moment + cross(skin - patella.origin, push)
        return Forces(force, moment, pulls, total)

    def normal_force(self, indentation: float, rate: float) -> float:
        """Returns k d^1.5 (1 + 3/2 alpha dd/dt), not negative (Hunt & Crossley 1975) [N]."""
        return rig.CONTACT_STIFFNESS * max(indentation, 0.0) ** 1.5 * max(1 + 1.5 * self.dissipation * rate, 0.0)

    def energy(self, time: float, y: NDArray) -> float:
        """Returns kinetic energy plus the potential energy of weight, springs and contact [J]."""
        patella, (femur, tibia) = _patella(y), self.bones.at(time)
        total = 0.5 * (rig.MASS * y[7:10] @ y[7:10] + y[10:] ** 2 @ rig.INERTIA) - rig.MASS * np.dot(rig.GRAVITY, y[:3])
        for spring, bone in zip(self.springs, (femur, tibia), strict=True):
            line = bone.point(spring.origin)[0] - patella.point(spring.insertion)[0]
            total += spring.energy(float(np.sqrt(line @ line)))
        for place in self.contact.stationary(femur.turn.T @ (patella.point(BUTTON)[0] - femur.origin)):
            total += place.sign * 0.4 * rig.CONTACT_STIFFNESS * max(rig.BUTTON_RADIUS - place.distance, 0.0) ** 2.5
        return float(total)

    def change(self, time: float, y: NDArray) -> NDArray:
        """Returns dy/dt from the Newton-Euler equations."""
        patella, spin, inertia = _patella(y), y[10:], np.array(rig.INERTIA)
        acting = self.forces(patella, *self.bones.at(time))
        moment = patella.turn.T @ acting.moment - cross(spin, inertia * spin)
        return np.concatenate([y[7:10], _turning(y[3:7], spin), acting.force / rig.MASS, moment / inertia])

    def motion(self, times: NDArray, start: NDArray | None = None) -> tuple[NDArray, int]:
        """Integrates from `start` (default: static equilibrium); returns states (n, 13) and number of evaluations."""
        start = self.resting(times[0]) if start is None else start
        ends = times[0], times[-1]
        solved = solve_ivp(self.change, ends, start, "LSODA", t_eval=times, rtol=TOLERANCE, atol=TOLERANCE)
        if not solved.success:
            raise RuntimeError(f"the plant stopped at {solved.t[-1]} s: {solved.message}")
        return solved.y.T, solved.nfev

    def seen(self, times: NDArray, states: NDArray) -> dict[str, NDArray]:
        """Returns the measured quantities of states (n, 13): the patella's pose in the femur frame, and forces."""
        rows = []
        for time, y in zip(times, states, strict=True):
            patella, (femur, tibia) = _patella(y), self.bones.at(time)
            acting = self.forces(patella, femur, tibia)
            origin = femur.turn.T @ (patella.point(BUTTON)[0] - femur.origin)
            rows.append(np.concatenate([origin, (femur.turn.T @ patella.turn).ravel(), acting.pulls, [acting.contact]]))
        seen = np.array(rows)
        quaternions = Rotation.from_matrix(seen[:, 3:12].reshape(-1, 3, 3)).as_quat(scalar_first=True)
        forces = {"femoral_spring": seen[:, 12], "tibial_spring": seen[:, 13], "contact": seen[:, 14]}
        return {"position": seen[:, :3], "quaternion": quaternions, **forces}

    def resting(self, time: float) -> NDArray:
        """Returns the static equilibrium with fixed bones at a time: slides from `START`, then finds the root."""
        femur, tibia = (b._replace(velocity=np.zeros(3), spin=np.zeros(3)) for b in self.bones.at(time))

        def unbalanced(y: NDArray) -> NDArray:
            """Force in world axes [N], and moment in patella axes divided by a lever arm of 2 cm [N]."""
            patella = _patella(y)
            acting = self.forces(patella, femur, tibia)
            return np.concatenate([acting.force, 50 * (patella.turn.T @ acting.moment)])

        def moved(y: NDArray, by: NDArray) -> NDArray:
            return np.concatenate([y[:3] + by[:3], y[3:7] + _turning(y[3:7], by[3:]), np.zeros(6)])

        def sliding(_: float, y: NDArray) -> NDArray:
            push = unbalanced(y)
            return np.concatenate([push[:3], _turning(y[3:7], 50 * push[3:]), np.zeros(6)])

        first = np.concatenate([femur.point(START - BUTTON)[0], [1, 0, 0, 0], np.zeros(6)])
        slid = solve_ivp(sliding, (0, 1), first, method="LSODA", rtol=1e-5, atol=1e-8).y[:, -1]
        scale = 1e-6
        found = root(lambda by: unbalanced(moved(slid, scale * by)), np.zeros(6), tol=1e-12)
        if np.abs(found.fun).max() > 1e-7:
            raise RuntimeError(f"the plant finds no equilibrium: {found.message}")
        return moved(slid, scale * found.x)


def plant_of(case: int) -> tuple[Plant, NDArray]:
    """Returns the plant that produces a case's measurements, and the times of the rig's frames [s]."""
    from pftwin.geometry.patch.implant import rig_implant
    from tests.verification.rig_plant.hand import hand_motion

    hand = hand_motion(case)
    bones = GuidedBones(hand[0].times, *((bone.positions, bone.quaternions) for bone in hand))
    implant = rig_implant()
    shape = SimpleNamespace(**{f.name: float(getattr(implant, f.name)) for f in fields(implant)})
    return Plant(bones, built_springs(rig.CASES[case]), ImplantContact(shape, rig.BUTTON_RADIUS)), hand[0].times


def built_springs(
    case: rig.RigCase, misplaced: float = rig.MISPLACED, stiffening: float = rig.STIFFENING
) -> tuple[Spring, ...]:
    """Returns quadriceps and patellar tendon with the attachment errors of the plant, the same in all cases."""
    random = np.random.default_rng(7)

    def spring(stiffness: float, length: float, along: int, support: tuple[float, float], side: str) -> Spring:
        insertion = np.array([along * rig.INSERTION[0], 0.0, rig.INSERTION[2]]) + random.normal(0.0, misplaced, 3)
        origin = np.array([support[0], rig.MEDIAL_LATERAL[side], support[1]]) + random.normal(0.0, misplaced, 3)
        return Spring(stiffness, length, rig.DAMPING_TIME * stiffness, insertion + BUTTON, origin, stiffening)

    return (
        spring(rig.QUADRICEPS_STIFFNESS, case.quadriceps_length, 1, rig.FEMUR_SUPPORT, case.femur_support),
        spring(rig.PATELLAR_TENDON_STIFFNESS, rig.PATELLAR_TENDON_LENGTH, -1, rig.TIBIA_SUPPORT, case.tibia_support),
    )


def run_plant(case: int) -> tuple[dict[str, NDArray], int]:
    """Simulates a case; returns its true quantities at the rig's frames (`Plant.seen`) and number of evaluations."""
    plant, times = plant_of(case)
    states, evaluations = plant.motion(times)
    return plant.seen(times, states), evaluations


def _patella(y: NDArray) -> Frame:
    turn = matrix(y[3:7])
    return Frame(y[:3], turn, y[7:10], turn @ y[10:])


def _turning(q: NDArray, spin: NDArray) -> NDArray:
    """dq/dt of a quaternion for an angular velocity in body axes."""
    return 0.5 * product(q, np.concatenate([[0.0], spin]))
