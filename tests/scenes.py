"""Small scenes and the few jitted functions that the physics tests share."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pftwin.base.spatial import Pose, Quaternion, Rotation, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import at_start, first_guide, frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import LinearImplicit
from pftwin.dynamics.ledger import Ledger
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import Guide, State, System
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.patch.charts import Chart, PlaneChart
from pftwin.geometry.patch.polynomial import PolynomialPatch, exponents
from pftwin.model.effects.base import Effect, Ground, Instant, Patella
from pftwin.model.effects.contact_law import ContactLaw, Flores
from pftwin.model.effects.gravity import Gravity
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.effects.tendon import Tendon
from pftwin.model.motion import Frame, KneeMotion
from pftwin.model.scene import PatellaBody, Scene

MASS, RADIUS, G = 0.12, 0.022, 9.81
OPTIMISED = {"xla_backend_optimization_level": 3}  # of `jax.jit`, for programs that run longer than they compile


def strong(x) -> jax.Array:
    """Numbers of a type of their own, as they come from files: those of Python are weak, and compile once more."""
    return jnp.asarray(np.asarray(x) if isinstance(x, int | float) else x)


J = strong


def scalar(x) -> jax.Array:
    return jnp.asarray(x, dtype=float)


def vec(x, y, z) -> Vec3:
    return Vec3(scalar(x), scalar(y), scalar(z))


def plane_chart() -> PlaneChart:
    return PlaneChart(vec(0, 0, 0), Rotation.from_array(np.eye(3)))


def patch_of(coefficients, degree: int, half=(0.024, 0.02), chart: Chart | None = None) -> PolynomialPatch:
    zero = J(0.0)
    chart = plane_chart() if chart is None else chart
    return PolynomialPatch(chart, J(coefficients), (zero, zero), (J(half[0]), J(half[1])), degree)


def flat_patch() -> PolynomialPatch:
    return patch_of([0.0, 0.0, 0.0], 1, (0.1, 0.1))


def fitted(surface, degree: int, half=(0.024, 0.02), chart: Chart | None = None) -> PolynomialPatch:
    """The polynomial nearest to surface(u, v) over the rectangle."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50)))
    basis = np.stack([u**i * v**j for i, j in exponents(degree)], 1)
    coefficients, *_ = np.linalg.lstsq(basis, surface(u * half[0], v * half[1]), rcond=None)
    return patch_of(coefficients, degree, half, chart)


def groove_patch(degree: int = 5) -> PolynomialPatch:
    """A groove along x, narrower than the button, symmetric about y = 0."""
    return fitted(lambda u, v: np.sqrt(v**2 + 0.005**2) * np.tan(np.radians(25)), degree)


def tendon(k=500.0, slack=0.05, c=0.0, insertion=(0, 0, 0), origin=(0, 0, 0.1), body="ground", name="tendon") -> Tendon:
    return Tendon(scalar(k), scalar(slack), scalar(c), vec(*insertion), vec(*origin), body, name=name)


def contact(law: ContactLaw, surface=None, center=(0, 0, 0)) -> SphereContact:
    return SphereContact(flat_patch() if surface is None else surface, law, vec(*center), J(RADIUS))


def gravity(mass: float = MASS) -> Gravity:
    return Gravity(J(mass), vec(0, 0, -G))


@eqx.filter_jit
def about(effect: Effect, center_of_mass: Vec3) -> Effect:
    """An effect made ready, in one program: operation by operation that of two meshes takes a quarter of a minute."""
    return effect.recentred(center_of_mass)


def system(*effects: Effect, mass: float = MASS, inertia=(3e-5, 3e-5, 4e-5)) -> System:
    about = tuple(e.recentred(vec(0, 0, 0)) for e in effects)
    return System(J(mass), vec(*inertia), about)


def still_guide() -> Guide:
    return Guide(None, Frame.world(), J(0.0))


def still_guide_at(part: float) -> Guide:
    return still_guide()


@eqx.filter_jit
def _start(sys: System, pose: Pose) -> State:
    return sys.start(pose, still_guide())


def state_at(sys: System, position, velocity=(0, 0, 0), spin=(0, 0, 0), orientation: Quaternion | None = None) -> State:
    turn = Quaternion.identity() if orientation is None else orientation
    at_rest = _start(sys, Pose(vec(*position), turn))
    return eqx.tree_at(lambda s: (s.velocity, s.spin), at_rest, (vec(*velocity), vec(*spin)))


def look(position=(0, 0, 0), velocity=(0, 0, 0), orientation: Quaternion | None = None, step=0.0, time=0.0) -> Instant:
    """An instant with a fixed femur and a tibia at the world's frame."""
    turn = Quaternion.identity() if orientation is None else orientation
    patella = Patella(vec(*position), turn.rotation(), vec(*velocity), vec(0, 0, 0))
    return Instant(patella, Ground(), Frame.world(), time, step)


def march(sys: System, state: State, duration: float, count: int, integrator: Integrator = LinearImplicit()) -> State:
    """The state after `count` equal steps over `duration`; one program serves all steps and counts."""
    return _march(sys, state, J(duration / count), J(int(count)), integrator)


@eqx.filter_jit
def _march(sys: System, state: State, step: jax.Array, count: jax.Array, integrator: Integrator) -> State:
    chosen = integrator
    state = chosen.begin(sys, state, still_guide(), step)
    return jax.lax.fori_loop(0, count, lambda _, s: chosen.advance(sys, s, still_guide_at, step, None)[0], state)


@eqx.filter_jit
def record(sys: System, state: State, step, count: int, integrator: Integrator = LinearImplicit()):
    """States and energy ledger after each of `count` steps."""
    chosen, zero = integrator, jnp.zeros(())
    state = chosen.begin(sys, state, still_guide(), step)

    def one(carry, _):
        after = chosen.advance(sys, carry[0], still_guide_at, step, carry[1])
        return after, after

    return jax.lax.scan(one, (state, Ledger.opened(zero)), None, length=count)[1]


def oscillator_errors(counts, integrator: Integrator) -> tuple[list[float], float]:
    """A mass on a damped tendon, let go above its rest: x = x0 exp(-zeta w t) (cos(...) + ...). Errors of x, and x0."""
    k, c, slack, x0, t = 200.0, 1.2, 0.05, 0.004, 0.35
    hanging = system(gravity(), tendon(k, slack, c))
    rest = 0.1 - slack - MASS * G / k
    start = state_at(hanging, (0, 0, rest + x0))
    w, zeta = np.sqrt(k / MASS), c / (2 * np.sqrt(k * MASS))
    damped = w * np.sqrt(1 - zeta**2)
    exact = x0 * np.exp(-zeta * w * t) * (np.cos(damped * t) + zeta * w / damped * np.sin(damped * t))
    ends = [march(hanging, start, t, n, integrator) for n in counts]
    return [abs(float(e.position.z) - rest - exact) for e in ends], x0


def stored(sys: System, state: State) -> jax.Array:
    """Potential energy of a state: the sum of what the effects store."""
    loads, _ = sys.loads(still_guide().instant(state.patella(), 0.0), state.memories)
    return sum((x.energy for x in loads if x.energy is not None), start=jnp.zeros(()))


@eqx.filter_jit
def energies(sys: System, states: State) -> jax.Array:
    """Kinetic plus potential energy of recorded states."""
    return jax.vmap(lambda s: sys.kinetic_energy(s) + stored(sys, s))(states)


def order_of(errors) -> np.ndarray:
    """Convergence orders from errors at steps halved each time."""
    errors = np.asarray(errors)
    return np.log2(errors[:-1] / errors[1:])


def trochlea_chart() -> PlaneChart:
    a = np.radians(40)
    ez, ey = np.array([-np.sin(a), 0, np.cos(a)]), np.array([0, 1.0, 0])
    return PlaneChart(Vec3.from_array(J(0.026 * ez)), Rotation.from_array(np.stack([np.cross(ey, ez), ey, ez], 1)))


def trochlea(degree: int = 5) -> PolynomialPatch:
    """A groove around the distal femur, about a trochlear radius of 26 mm."""

    def surface(u, v):
        around = np.sqrt(0.026**2 - (0.85 * u) ** 2) - 0.026
        return around + np.sqrt(v**2 + 0.006**2) * np.tan(np.radians(18))

    return fitted(surface, degree, chart=trochlea_chart())


def knee_motion(n_frames: int = 31, femur: PoseSeries | None = None) -> KneeMotion:
    """The tibia flexes about the knee's centre by 45 deg, and some more, at 100 Hz."""
    t = np.arange(n_frames, dtype=np.float64) * 0.01
    flexion = np.radians(45 + 20 * np.sin(2 * np.pi * t / 1.8) ** 2)
    tibia = PoseSeries(t, np.zeros((t.size, 3)), np.stack([np.cos(flexion / 2), 0 * t, -np.sin(flexion / 2), 0 * t], 1))
    return KneeMotion.from_poses(femur, tibia)


def knee(n_frames: int = 31, law: ContactLaw | None = None) -> Scene:
    """A knee with two tendons, a grooved trochlea and weight: everything that a rig has, small."""
    law = Flores(J(2e8), J(0.6)) if law is None else law
    quadriceps = tendon(156, 0.1432, 1.56, (0.02, 0, -0.008), (0.22, 0.012, 0.035), "femur", "quadriceps")
    patellar = tendon(629, 0.0714, 6.29, (-0.02, 0, -0.008), (-0.07, 0.01, 0.045), "tibia", "patellar_tendon")
    button = contact(law, trochlea())
    body = PatellaBody(J(MASS), vec(3e-5, 3e-5, 4e-5), vec(0.001, 0, 0.004))
    start = Pose(vec(-0.005, 0.001, 0.05), Quaternion.identity())
    return Scene(body, (gravity(), quadriceps, patellar, button), knee_motion(n_frames), start, "small knee")


def settled(scene: Scene) -> Solution:
    """The equilibrium at the first frame, by one program for motions of any length."""
    return _settled(at_start(scene))


_settled = eqx.filter_jit(starting_equilibrium)


@eqx.filter_jit
def run(scene: Scene, start: Solution, substeps: int = 10):
    """FrameStates with its ledger, and what it shows, from a known start."""
    path = frame_states(scene, substeps=substeps, start=start, ledger=True)
    return path, observe(scene, path)


def starting_as_it_is(scene: Scene) -> Solution:
    """The scene's own start pose in the place of an equilibrium, of whose types it is: programs serve both."""
    return eqx.filter_jit(traced_as_it_is)(at_start(scene))


def traced_as_it_is(scene: Scene) -> Solution:
    """`starting_as_it_is` of a scene that may be traced."""
    pose = scene.center_of_mass_pose()
    still = first_guide(scene).instant(Patella.at_rest(pose.position, pose.orientation), 0.0)
    made = Solution(pose, System.of(scene).remember(still), J(0.0), J(0), jnp.zeros((6, 6)), J(0.0))
    return jax.tree.map(lambda a: jnp.asarray(a, a.dtype), made)  # none of a weak type
