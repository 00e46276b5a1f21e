"""`trajectory`: the patella's motion and forces as a pure function of a scene, for jit, vmap and differentiation.

path = pftwin.trajectory(scene, integrator=pftwin.BDF2(), dt=5e-3)
jax.grad(lambda s: pftwin.trajectory(s).contact_force.norm().max())(scene)
jax.vmap(lambda k: pftwin.trajectory(scene.set("quadriceps.stiffness", k)).shift.max())(stiffnesses)
"""

from __future__ import annotations

from os import PathLike
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.base.errors import InputError
from pftwin.base.rotations import PatellarAngles, TibiofemoralAngles, patellar_angles, tibiofemoral_angles
from pftwin.base.spatial import Pose, Quaternion, Scalar, Vec3
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium, substeps_for
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import observe
from pftwin.model.scene import Scene

DEFAULT_STEP = 1e-3  # [s]


class Trajectory(eqx.Module):
    """A motion at the n recorded frames, the leading axis of all arrays. `units` contains the unit of each field.

    Positions and forces are in the femur frame: x proximal, y lateral, z anterior.
    """

    times: Scalar  # (n,)
    center: Vec3  # of the button's sphere; without contact, the patella's origin
    patella: Pose  # patella frame in the femur frame
    knee: TibiofemoralAngles  # of the tibia in the femur
    effects: dict[str, dict[str, Array]]  # all observables, by effect and name
    contact_force: Vec3  # on the patella; zero without a contact
    contact_force_medial: Scalar  # magnitude on each facet; zero without a contact
    contact_force_lateral: Scalar
    tensions: dict[str, Array]  # of tendons, strands and muscles, by name; summed over a group
    lengths: dict[str, Array]  # of those that report a length, by name
    kinetic_energy: Scalar
    stored_energy: dict[str, Scalar]  # by effect
    work: Scalar | None  # of guided bodies and prescribed tensions since the start; None without an energy budget
    heat: Scalar | None  # dissipated by damping since the start
    numerical_dissipation: Scalar | None  # by the integrator since the start; negative if it adds energy
    flags: Array  # (n,) int, bits of `pftwin.Status`; 0 for a reliable frame
    start_residual: Scalar  # () of the initial equilibrium
    units: ClassVar[dict[str, str]] = {
        "times": "s",
        **dict.fromkeys(("center", "position", "shift", "lengths"), "m"),
        **dict.fromkeys(("angles", "knee"), "rad"),
        **dict.fromkeys(("contact_force", "contact_force_medial", "contact_force_lateral", "tensions"), "N"),
        **dict.fromkeys(("kinetic_energy", "stored_energy", "work", "heat", "numerical_dissipation"), "J"),
        "start_residual": "N",
    }

    @property
    def position(self) -> Vec3:
        """Origin of the patella frame in the femur frame, (n,) [m]."""
        return self.patella.position

    @property
    def angles(self) -> PatellarAngles:
        """Flexion, rotation (internal positive) and tilt (lateral positive) of the patella in the femur, (n,) [rad]."""
        return patellar_angles(self.patella.orientation)

    @property
    def shift(self) -> Scalar:
        """Medial-lateral position of the button's centre, lateral positive, (n,) [m]."""
        return self.center.y


def trajectory(
    scene: Scene,
    *,
    integrator: Integrator | None = None,
    dt: float = DEFAULT_STEP,
    start: Solution | None = None,
    energy_budget: bool = False,
) -> Trajectory:
    """The patella's motion and forces over the recorded frames, from static equilibrium, as a pure function.

    JAX's transformations (`jit`, `vmap`, `jvp`, `grad`, ...) apply to every parameter of the scene. If none is traced,
    the program is compiled once for all scenes of the same structure. Unlike `pftwin.simulate`, it neither checks the
    scene nor falls back on relaxation if the search for the equilibrium fails: see `flags`.

    Args:
        scene: the model; its parameters may be traced.
        integrator: `pftwin.BDF2()` by default; see `pftwin.Integrator`.
        dt: maximum step [s]; the step is the largest up to it that divides the interval between frames. It is not
            refined, and its error is not estimated, unlike in `pftwin.simulate`.
        start: initial equilibrium; by default it is solved for and differentiated through.
        energy_budget: compute work and heat at every step.

    Returns:
        The motion at the recorded frames.

    Raises:
        InputError: `scene` is not one, the step is not a positive number or is traced, `integrator` is not one, or it
            does not support an effect.
    """
    checked_scene(scene, "trajectory")
    chosen = BDF2() if integrator is None else checked_integrator(integrator, "trajectory")
    substeps = substeps_for(scene.motion.frame_interval, dt)
    return _computed(scene.unnamed(), start, chosen, substeps, energy_budget)


def checked_scene(given: object, where: str) -> Scene:
    """Returns `given` if it is a scene.

    Raises:
        InputError: otherwise; for a path, the message gives the call that loads it.
    """
    if isinstance(given, Scene):
        return given
    remedy = f'pftwin.load_scene("{given}")' if isinstance(given, str | PathLike) else None
    raise InputError(f"found {given!r}", where=where, expected="a scene", remedy=remedy)


def checked_integrator(given: object, where: str) -> Integrator:
    """Returns `given` if it is an integrator.

    Raises:
        InputError: otherwise; for a name as on the command line, the message gives the corresponding object.
    """
    if isinstance(given, Integrator):
        return given
    remedy = None
    if isinstance(given, str):
        from pftwin.dynamics.integrator_text import integrator_from_text

        remedy = f"pftwin.{integrator_from_text(given)!r}"
    expected = "an integrator, such as pftwin.BDF2()"
    raise InputError(f"found {given!r}", where=f"{where}: integrator", expected=expected, remedy=remedy)


@eqx.filter_jit
def _computed(
    scene: Scene, start: Solution | None, integrator: Integrator, substeps: int, energy_budget: bool
) -> Trajectory:
    start = starting_equilibrium(scene) if start is None else start
    states = frame_states(scene, integrator=integrator, substeps=substeps, start=start, ledger=energy_budget)
    observation, books = observe(scene, states), states.ledger
    times, contact = scene.motion.frame_times(), scene.contact
    nothing = jnp.zeros_like(observation.center.x)
    report = {} if contact is None else observation.effects[contact.name]
    lines = [e.name for e in scene.effects if e.line_element() is not None]
    return Trajectory(
        times=times,
        center=observation.center,
        patella=observation.patella,
        knee=knee_angles(scene),
        effects=observation.effects,
        contact_force=Vec3(*(report.get(f"force_{axis}", nothing) for axis in "xyz")),
        contact_force_medial=report.get("force_medial", nothing),
        contact_force_lateral=report.get("force_lateral", nothing),
        tensions={  # (n,) from (n,) or (n, lines)
            n: observation.effects[n]["tension"].reshape(len(times), -1).sum(axis=1)
            for n in lines
            if "tension" in observation.effects[n]
        },
        lengths={n: observation.effects[n]["length"] for n in lines if "length" in observation.effects[n]},
        kinetic_energy=observation.kinetic_energy,
        stored_energy=observation.potential_energy,
        work=None if books is None else books.work,
        heat=None if books is None else books.heat,
        numerical_dissipation=None if books is None else books.numerical_dissipation(observation.kinetic_energy),
        flags=observation.status,
        start_residual=start.residual,
    )


def knee_angles(scene: Scene) -> TibiofemoralAngles:
    """Angles of the tibia in the femur at the recorded frames, (n,) [rad]; a pure function."""
    femur, tibia = scene.motion.frames(scene.motion.frame_times())
    turn = Quaternion.from_rotation(tibia.rotation)
    if femur is not None:
        turn = Quaternion.from_rotation(femur.rotation).conjugate() * turn
    return tibiofemoral_angles(turn)
