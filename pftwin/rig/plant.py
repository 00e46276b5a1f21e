"""The plant: what the virtual laboratory measures. Its mechanics are its own: NumPy and SciPy, none of the twin's code.

With the twin it shares the numbers of the rig (`pftwin.rig.geometry`) and of the implant's shape, and what both assume:
one rigid patella, straight springs, a sphere pressed into a surface by a law of indentation, guided bones. On purpose
it differs: the true smooth implant instead of a polynomial, a memoryless contact law, a little friction, springs that
stiffen, attachments a millimetre off, other drag, and another integrator. SI units and radians.
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
from pftwin.rig.plant_contact import ImplantContact
from pftwin.rig.plant_parts import Frame, GuidedBones, Spring, cross, matrix, product

FRICTION = 0.02  # coefficient of the lubricated contact
STICTION_SPEED = 2e-3  # below it friction fades [m/s]
DISSIPATION = 1.0  # alpha of the contact law [s/m]
STIFFENING = 0.05  # share by which a spring is stiffer when stretched by a quarter of its length
MISPLACED = 0.6e-3  # standard deviation of an attachment's coordinates: about 1 mm in all [m]
DRAG = 1.1 * rig.DRAG[0], 0.9 * rig.DRAG[1]  # [N s/m, N m s/rad]
TOLERANCE = 1e-8  # of the integrator, relative and absolute
BUTTON = -np.array(rig.CENTER_OF_MASS)  # middle of its sphere, from the centre of mass [m]
START = np.array([5e-3, 0.0, 49.3e-3])  # of the button's middle in the femur, about where it rests at first [m]


class Forces(NamedTuple):
    """What acts on the patella at an instant."""

    force: NDArray  # world axes [N]
    moment: NDArray  # about the centre of mass, world axes [N m]
    pulls: list[float]  # of the springs [N]
    contact: float  # sum of the normal forces [N]


@dataclass
class Plant:
    """The patella on a spring from the femur and one from the tibia, its button on the femur's implant.

    Its state (13,) is the position of the centre of mass and the quaternion from patella to world, the velocity in
    world axes, and the angular velocity in patella axes.
    """

    bones: GuidedBones
    springs: tuple[Spring, ...]  # from the femur and from the tibia
    contact: ImplantContact
    drag: tuple[float, float] = DRAG
    friction: float = FRICTION
    dissipation: float = DISSIPATION

    def forces(self, patella: Frame, femur: Frame, tibia: Frame) -> Forces:
        """Weight, drag against the femur, springs, contact and its friction."""
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
        """k d^1.5 (1 + 3/2 alpha dd/dt), never negative (Hunt & Crossley 1975) [N]."""
        return rig.CONTACT_STIFFNESS * max(indentation, 0.0) ** 1.5 * max(1 + 1.5 * self.dissipation * rate, 0.0)

    def energy(self, time: float, y: NDArray) -> float:
        """Kinetic energy, and what weight, springs and contact store [J]."""
        patella, (femur, tibia) = _patella(y), self.bones.at(time)
        total = 0.5 * (rig.MASS * y[7:10] @ y[7:10] + y[10:] ** 2 @ rig.INERTIA) - rig.MASS * np.dot(rig.GRAVITY, y[:3])
        for spring, bone in zip(self.springs, (femur, tibia), strict=True):
            line = bone.point(spring.origin)[0] - patella.point(spring.insertion)[0]
            total += spring.energy(float(np.sqrt(line @ line)))
        for place in self.contact.stationary(femur.turn.T @ (patella.point(BUTTON)[0] - femur.origin)):
            total += place.sign * 0.4 * rig.CONTACT_STIFFNESS * max(rig.BUTTON_RADIUS - place.distance, 0.0) ** 2.5
        return float(total)

    def change(self, time: float, y: NDArray) -> NDArray:
        """dy/dt: Newton's and Euler's equations."""
        patella, spin, inertia = _patella(y), y[10:], np.array(rig.INERTIA)
        acting = self.forces(patella, *self.bones.at(time))
        moment = patella.turn.T @ acting.moment - cross(spin, inertia * spin)
        return np.concatenate([y[7:10], _turning(y[3:7], spin), acting.force / rig.MASS, moment / inertia])

    def motion(self, times: NDArray, start: NDArray | None = None) -> tuple[NDArray, int]:
        """States (n, 13) at times, from rest unless a start is given; and how often the forces were evaluated."""
        start = self.resting(times[0]) if start is None else start
        ends = times[0], times[-1]
        solved = solve_ivp(self.change, ends, start, "LSODA", t_eval=times, rtol=TOLERANCE, atol=TOLERANCE)
        if not solved.success:
            raise RuntimeError(f"the plant stopped at {solved.t[-1]} s: {solved.message}")
        return solved.y.T, solved.nfev

    def seen(self, times: NDArray, states: NDArray) -> dict[str, NDArray]:
        """What is measured of states (n, 13): the patella frame's origin and quaternion in the femur, and forces."""
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
        """The state in static equilibrium at a time, bones held still: slid there from `START`, then solved for."""
        femur, tibia = (b._replace(velocity=np.zeros(3), spin=np.zeros(3)) for b in self.bones.at(time))

        def unbalanced(y: NDArray) -> NDArray:
            """Force, world axes [N], and moment, patella axes, over the insertions' 2 cm [N]."""
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
    """The plant behind a case's measurements, and the times of the rig's frames [s]."""
    from pftwin.geometry.patch.implant import rig_implant
    from pftwin.rig.hand import hand_motion

    hand = hand_motion(case)
    bones = GuidedBones(hand[0].times, *((bone.positions, bone.quaternions) for bone in hand))
    implant = rig_implant()
    shape = SimpleNamespace(**{f.name: float(getattr(implant, f.name)) for f in fields(implant)})
    return Plant(bones, built_springs(rig.CASES[case]), ImplantContact(shape, rig.BUTTON_RADIUS)), hand[0].times


def built_springs(
    case: rig.RigCase, misplaced: float = MISPLACED, stiffening: float = STIFFENING
) -> tuple[Spring, ...]:
    """Quadriceps and patellar tendon as built: one rig, so the attachments are misplaced alike in all cases."""
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
    """The truth of a case at the rig's frames, see `Plant.seen`, and how often the forces were evaluated."""
    plant, times = plant_of(case)
    states, evaluations = plant.motion(times)
    return plant.seen(times, states), evaluations


def _patella(y: NDArray) -> Frame:
    turn = matrix(y[3:7])
    return Frame(y[:3], turn, y[7:10], turn @ y[10:])


def _turning(q: NDArray, spin: NDArray) -> NDArray:
    """dq/dt under an angular velocity in the body's own axes."""
    return 0.5 * product(q, np.concatenate([[0.0], spin]))
