"""The plant: what the virtual laboratory measures. It differs from the twin on purpose.

The true smooth implant instead of a polynomial, a memoryless contact law, a little friction, springs that stiffen,
attachments a millimetre off, other drag, and diffrax at a tight tolerance instead of the twin's integrator.

An unsteady hand moves femur and tibia: from 45 deg of flexion, two flexions and two extensions, a little different in
each case. In cases 2 and 3 the leg is extended only in part the first time, as in the paper (section 2.1). Synthetic,
and the truth of which the rig's markers are noisy samples.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3, Wrench, safe_sqrt
from pftwin.dynamics.equilibrium import solve_equilibrium
from pftwin.dynamics.frame_states import FrameStates, first_guide
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import Guide, State, System, gyroscopic
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.implant import rig_implant
from pftwin.model.effects.base import Effect, Instant, Load, applied_at
from pftwin.model.effects.contact import load_of
from pftwin.model.effects.contact_law import HuntCrossley
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.effects.tendon import Tendon
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene
from pftwin.rig import geometry as rig
from pftwin.rig.cases import effects, patella_body
from pftwin.rig.geometry import DURATION, HIP, RATE

# Turning points: time [s], knee flexion [deg].
_FULL = ((0, 45), (0.6, 45), (1.7, 88), (3.1, 6), (4.5, 86), (5.9, 0), (7.2, 52))
_PARTIAL = ((0, 45), (0.6, 45), (1.7, 88), (3.1, 50), (4.5, 86), (5.9, 0), (7.2, 52))
_SMOOTHING = 0.08  # [s]


def hand_motion(case: int) -> tuple[PoseSeries, PoseSeries]:
    """Femur and tibia in the world, of a case, at the rig's frames."""
    from scipy.spatial.transform import Rotation

    times = np.arange(round(DURATION * RATE) + 1) / RATE
    random = np.random.default_rng(100 + case)
    flexion = _flexion(times, case, random)
    active = _active(times)
    hip = np.stack(
        [
            _wobble(times, random, 1.5) * active,
            -0.06 * (flexion - flexion[0]) - _wobble(times, random, 1.0) * active,
            _wobble(times, random, 1.2) * active,
        ],
        axis=1,
    )
    femur_turn = Rotation.from_rotvec(np.radians(hip))
    femur_origin = np.array(HIP) - femur_turn.apply(np.array(HIP))
    adduction, internal = _wobble(times, random, 0.8) * active, 0.05 * flexion + _wobble(times, random, 1.0) * active
    tibia_in_femur = Rotation.from_euler("YZX", np.stack([-flexion, adduction, internal], axis=1), degrees=True)
    rollback = np.stack([0 * flexion, 0 * flexion, -4e-5 * flexion], axis=1)
    tibia_turn = femur_turn * tibia_in_femur
    tibia_origin = femur_origin + femur_turn.apply(rollback)
    femur, tibia = (
        PoseSeries(times, origin, turn.as_quat(scalar_first=True), source=f"hand, case {case}")
        for origin, turn in ((femur_origin, femur_turn), (tibia_origin, tibia_turn))
    )
    return femur, tibia


def _flexion(times: NDArray, case: int, random: np.random.Generator) -> NDArray:
    """Knee flexion [deg]."""
    from scipy.interpolate import PchipInterpolator
    from scipy.ndimage import gaussian_filter1d

    knots = np.array(_PARTIAL if case in (2, 3) else _FULL, dtype=float)
    knots[2:-1, 0] += random.uniform(-0.08, 0.08, len(knots) - 3)
    knots[[2, 4], 1] += random.uniform(-2, 2, 2)
    smooth = gaussian_filter1d(PchipInterpolator(*knots.T)(times), _SMOOTHING * RATE, mode="nearest")
    return smooth + _wobble(times, random, 0.6) * _active(times)


def _active(times: NDArray) -> NDArray:
    """0 while the leg is held still at first, then 1, smoothly."""
    s = np.clip((times - 0.35) / 0.6, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s * s)


def _wobble(times: NDArray, random: np.random.Generator, size: float) -> NDArray:
    """An unsteady hand: a few sinusoids between 0.3 and 2 Hz, faster ones smaller [deg]."""
    total = np.zeros_like(times)
    for frequency in random.uniform(0.3, 2.0, 4):
        total += np.sin(2 * np.pi * (frequency * times + random.uniform())) / (1 + frequency**2)
    return 0.7 * size * total


FRICTION = 0.02  # coefficient of the lubricated contact
STICTION_SPEED = 2e-3  # below it friction fades [m/s]
STIFFENING = 0.05  # share by which a spring is stiffer when stretched by a quarter of its length
MISPLACED = 0.6e-3  # standard deviation of an attachment's coordinates: about 1 mm in all [m]
TOLERANCE = 1e-6


class StiffeningTendon(Tendon):
    """A spring that stiffens: F = K s (1 + 0.05 s / (L0 / 4)) + c dL/dt over the stretch s."""

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """The pull."""
        line = self.line(now)
        stretch = jnp.maximum(line.length - self.slack_length, 0.0)
        more = STIFFENING * stretch / (0.25 * self.slack_length)
        elastic = self.stiffness * stretch * (1 + more)
        pull = jnp.where(stretch > 0, jnp.maximum(elastic + self.damping * line.lengthening, 0.0), 0.0)
        energy = self.stiffness * stretch**2 * (0.5 + more / 3)
        term = line.term(pull, elastic, self.stiffness * (1 + 2 * more), self.damping)
        return Load(stiff=(term,), energy=energy), memory


class LubricatedContact(SphereContact):
    """Sphere contact with a little regularised Coulomb friction; its places are searched for at every instant."""

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """Normal forces, and friction against the sliding of the sphere's skin."""
        one, two, memory = self.touches(now, self.remember(now))
        wrench = Wrench.zero()
        for touch in (one, two):
            normal = touch.push.term.direction
            lever = self.center - self.radius * now.patella.rotation.unapply(normal)
            arm = now.patella.arm(lever)
            slip = now.femur.relative_velocity(now.patella.velocity_at(arm), now.patella.position + arm)
            slip = slip - slip.dot(normal) * normal
            speed = safe_sqrt(slip.squared_norm() + STICTION_SPEED**2)
            drag = (-FRICTION * touch.push.term.force / speed) * slip
            wrench = wrench + Wrench(drag, applied_at(lever, now.patella, drag))
        return load_of([one.push, two.push])[0]._replace(wrench=wrench), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Any]:
        """The observables of the twin's contact."""
        return super().observe(now, self.remember(now))


def plant_scene(case: int) -> Scene:
    """The true scene behind a case's measurements."""
    random = np.random.default_rng(7)  # one rig: the same misplaced attachments in all cases
    surface = jax.tree.map(lambda a: number(a) if isinstance(a, float) else a, rig_implant())
    law = HuntCrossley(number(rig.CONTACT_STIFFNESS), number(1.0))
    contact = LubricatedContact(surface, law, vector((0.0, 0.0, 0.0)), number(rig.BUTTON_RADIUS))
    built = tuple(_as_built(effect, random) for effect in effects(rig.CASES[case], contact))
    femur, tibia = hand_motion(case)
    radius = rig.BUTTON_RADIUS + float(surface.trochlear_radius)
    start = Pose(vector((0.1 * radius, 0.0, 0.99 * radius)), Quaternion.identity())
    motion = KneeMotion.from_poses(femur, tibia)
    return Scene(patella_body(), built, motion, start, f"plant, case {case}", synthetic=True)


def _as_built(effect: Any, random: np.random.Generator) -> Effect:
    """The effect as built: attachments misplaced, springs that stiffen, other drag."""
    if effect.line_element() is not None:
        insertion, origin = (
            place + vector(tuple(random.normal(0.0, MISPLACED, 3))) for place in (effect.insertion, effect.origin)
        )
        law = effect.stiffness, effect.slack_length, effect.damping
        return StiffeningTendon(*law, insertion, origin, effect.body, name=effect.name)
    if effect.name == "damping":
        return LinearDamping(1.1 * effect.translational, 0.9 * effect.rotational, body=effect.body)
    return effect


def _derivative(time: Scalar, y: tuple[Vec3, Quaternion, Vec3, Vec3], args: tuple[System, KneeMotion]) -> Any:
    """d/dt of position, orientation, velocity and spin."""
    system, motion = args
    position, raw, velocity, spin = y
    state = State(position, raw.normalised(), velocity, spin, tuple(None for _ in system.effects))
    loads, _ = system.loads(Guide.sample(motion, time).instant(state.patella(), 0.0), state.memories)
    total = sum((load.total() for load in loads), start=Wrench.zero())
    moment, i = total.moment + gyroscopic(system.inertia, spin), system.inertia
    half = Quaternion(jnp.zeros_like(spin.x), 0.5 * spin.x, 0.5 * spin.y, 0.5 * spin.z)
    return (
        velocity,
        raw * half,
        (1 / system.mass) * total.force,
        Vec3(moment.x / i.x, moment.y / i.y, moment.z / i.z),
    )


@eqx.filter_jit
def _integrate(scene: Scene) -> tuple[State, Any, Scalar]:
    import diffrax

    system = System.of(scene)
    start = solve_equilibrium(system, first_guide(scene), scene.center_of_mass_pose())
    times = scene.motion.frame_times()
    zero = Vec3(*(jnp.zeros_like(start.residual) for _ in range(3)))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_derivative),  # pyright: ignore[reportArgumentType]
        diffrax.Tsit5(),
        t0=times[0],
        t1=times[-1],
        dt0=1e-5,
        y0=(start.pose.position, start.pose.orientation, zero, zero),
        args=(system, scene.motion),
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.PIDController(rtol=TOLERANCE, atol=TOLERANCE, dtmax=2e-3),
        max_steps=5_000_000,
        adjoint=diffrax.ForwardMode(),
    )
    assert solution.ys is not None
    position, orientation, velocity, spin = solution.ys
    memories = tuple(None for _ in system.effects)
    return State(position, orientation.normalised(), velocity, spin, memories), start, solution.stats["num_steps"]


def run_plant(case: int) -> tuple[Scene, dict[str, NDArray], int]:
    """The truth of a case at the rig's frames: patella pose in the femur, three forces; and the steps taken."""
    scene = plant_scene(case)
    states, start, steps = _integrate(scene)
    seen = eqx.filter_jit(observe)(scene, FrameStates(states, None, start, jnp.zeros(())))
    truth = {
        "position": seen.patella.position.array(),
        "quaternion": seen.patella.orientation.array(),
        "contact": seen.effects["contact"]["force"],
        "tibial_spring": seen.effects["patellar_tendon"]["tension"],
        "femoral_spring": seen.effects["quadriceps"]["tension"],
    }
    return scene, {name: np.asarray(a) for name, a in truth.items()}, int(steps)
