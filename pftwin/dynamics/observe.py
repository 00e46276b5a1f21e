"""What a trajectory shows: poses in the femur's frame, what each effect reports, energies, and a status per frame."""

from __future__ import annotations

import enum

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from pftwin.dynamics.integrators import integrator_named
from pftwin.dynamics.packing import map_rows
from pftwin.dynamics.state import Guide, State
from pftwin.dynamics.trajectory import Trajectory
from pftwin.scene import Scene
from pftwin.spatial import Pose, Quaternion, Scalar, Vec3

FARTHEST = 0.25  # a way within one step beyond this share of the button's radius leaps over what it should feel
MOST_TURN = 0.3  # [rad] within one step: up to here the orientation's update is exact
MOST_CREATED = 0.02  # energy from nowhere, as a share of the largest that moves; times the milliseconds of longer steps
MOST_SO_FAR = 0.2  # and as a share of the largest that has moved so far
LEAST_CREATED = 1e-6  # below which nothing is said [J]
DEEPEST = 0.05  # an indentation beyond this share of the button's radius is no small deformation any more


class Status(enum.IntFlag):
    """How far a frame can be trusted; 0 is a clean frame."""

    OK = 0
    NO_CONTACT = 1
    LEFT_PATCH = 2
    DEEP_INDENTATION = 4
    NOT_FINITE = 8
    START_NOT_IN_EQUILIBRIUM = 16
    STEP_TOO_LONG = 32
    SEARCH_OVERFLOW = 64
    ENERGY_FROM_NOWHERE = 128
    SNAPPED = 256

    def describe(self) -> str:
        """The status in words."""
        if not self:
            return "ok"
        return "; ".join(_WORDS[flag] for flag in Status if flag in self)


_WORDS = {
    Status.NO_CONTACT: "the button touches nothing",
    Status.LEFT_PATCH: "a loaded contact lies beyond the edge of the fitted patch, on its tangential continuation, or"
    " reaches over the rim of the mesh",
    Status.DEEP_INDENTATION: f"indentation above {DEEPEST:.0%} of the button's radius, or deeper than is looked for:"
    " step too large or law too soft",
    Status.NOT_FINITE: "not finite: step too large, or a load that is not known",
    Status.STEP_TOO_LONG: "the patella moves or turns too far within one step, or the step's equations are not solved:"
    " take a shorter one",
    Status.SEARCH_OVERFLOW: "the search for what touches ran out of room: a contact may be wrong",
    Status.SNAPPED: "the equilibrium ended and the patella snapped to another one, in a dynamic burst without a time",
    Status.ENERGY_FROM_NOWHERE: "there is more energy than before, less the work done: step too long, or forces that"
    " have no potential, as those of coarse meshes",
    Status.START_NOT_IN_EQUILIBRIUM: "the run did not start from a converged equilibrium",
}

RESERVATIONS = {  # what effects report, and what it says where positive
    "off_patch": Status.LEFT_PATCH,
    "at_rim": Status.LEFT_PATCH,
    "overflow": Status.SEARCH_OVERFLOW,
    "too_deep": Status.DEEP_INDENTATION,
}


class Observation(eqx.Module):
    """Arrays over the recorded frames (leading axis n)."""

    patella: Pose  # patella frame in the femur's
    center: Vec3  # the button's sphere centre (else the patella's origin) in the femur's frame [m]
    effects: dict[str, dict[str, Array]]
    kinetic_energy: Scalar
    potential_energy: dict[str, Scalar]  # stored by each effect that stores any [J]
    status: Array  # (n,) int, bits of `Status`
    drift: Array | None = None  # (n,) largest violation of a constraint so far, where the integrator has any [m]


def observe(scene: Scene, path: Trajectory) -> Observation:
    """Looks at every recorded frame. Pure: jit and vmap apply."""
    system, chosen = scene.system(), integrator_named(path.integrator)
    # Clear of the frames' rounding: the last frame is asked for itself.
    times = scene.motion.start_time + scene.motion.frame_interval * jnp.arange(scene.motion.n_frames).astype(float)
    guides = Guide.sample(scene.motion, times)

    def look(state: State, guide: Guide) -> tuple[Pose, Vec3, dict, Scalar, dict, Array]:
        now = guide.instant(state.patella(), 0.0)
        reports = {e.name: e.report(now, m) for e, m in zip(system.effects, state.memories, strict=True)}
        seen = {name: shown for name, (shown, _) in reports.items()}
        stored = {name: energy for name, (_, energy) in reports.items() if energy is not None}
        turn = state.orientation
        femur_to_world = (
            Quaternion.identity() if guide.femur is None else Quaternion.from_rotation(guide.femur.rotation)
        )
        origin = now.femur.to_local(state.position - turn.rotate(scene.patella.center_of_mass))
        relative = femur_to_world.conjugate() * turn
        center = origin + relative.rotate(scene.tracked_point())
        status = _status(scene, seen, state, path.step, chosen.unsettled(state))
        kinetic = system.kinetic_energy(state) if chosen.inertia else jnp.zeros_like(path.step)
        return Pose(origin, relative), center, seen, kinetic, stored, status

    # A loop, which is the same program as one frame's and so is compiled as quickly.
    patella, center, seen, kinetic, stored, status = map_rows(lambda at: look(*at), (path.states, guides))
    badly_started = jnp.where(path.start.converged(), 0, int(Status.START_NOT_IN_EQUILIBRIUM))
    # What was finite at the start, and loads that are all known, become infinite by too long a step alone.
    lost, unknown = ((status & int(flag)) > 0 for flag in (Status.NOT_FINITE, Status.SEARCH_OVERFLOW))
    blown_up = lost & ~lost[0] & ~unknown.any()
    flags = status | badly_started | jnp.where(blown_up, int(Status.STEP_TOO_LONG), 0)
    if path.ledger is not None:
        created = _created(kinetic, stored, path.ledger.work, path.step) & ~lost
        flags = flags | jnp.where(created, int(Status.ENERGY_FROM_NOWHERE), 0)
    flags = flags | _snapped(chosen.snaps(path.states))
    return Observation(patella, center, seen, kinetic, stored, flags, chosen.drift(path.states))


def _snapped(snaps: Array | None) -> Array | int:
    """Frames before which a motion without inertia has left its equilibrium for another."""
    return 0 if snaps is None else jnp.where(jnp.diff(snaps, prepend=0) > 0, int(Status.SNAPPED), 0)


def _created(kinetic: Scalar, stored: dict[str, Scalar], work: Scalar, step: Scalar) -> Array:
    """(n,): whether by a frame kinetic and stored energy, less the work done, have risen above what was left of them.

    Heat only lowers them, so its account plays no part; that of work is of first order in the step.
    """
    changes = [kinetic, work, *(energy - energy[0] for energy in stored.values())]
    total = sum(stored.values(), start=kinetic)
    left = total - work
    rise = left - jax.lax.cummin(left)
    moving, size = (
        jnp.where(jnp.isfinite(x), x, 0.0) for x in (jnp.abs(jnp.stack(changes)).max(axis=0), jnp.abs(total))
    )
    # Of all that ever moves; where that blows up later, of what has moved so far, in which little is much.
    most = jnp.minimum(MOST_CREATED * moving.max(), MOST_SO_FAR * jax.lax.cummax(moving))
    rounding = 1000 * jnp.finfo(left.dtype).eps * jax.lax.cummax(size)
    return jax.lax.cummax(rise) > jnp.maximum(1.0, step / 1e-3) * most + rounding + LEAST_CREATED


def _status(
    scene: Scene, seen: dict[str, dict[str, Array]], state: State, step: Scalar, unsettled: Scalar | None
) -> Array:
    too_long = step * state.spin.norm() > MOST_TURN
    if unsettled is not None:
        too_long = too_long | (unsettled > 0)
    flags = jnp.where(too_long, int(Status.STEP_TOO_LONG), 0)
    for effect in scene.effects:
        report = seen[effect.name]
        flags = flags | reservations(report)
        conditions = []
        if effect.followed() is not None:  # a button, whatever it is on
            conditions.append((report["force"] <= 0, Status.NO_CONTACT))
        if "indentation_medial" in report:
            radius = getattr(effect, "radius", None)
            if radius is not None:
                deepest = jnp.fmax(report["indentation_medial"], report["indentation_lateral"])
                conditions.append((deepest > DEEPEST * radius, Status.DEEP_INDENTATION))
                conditions.append((step * state.velocity.norm() > FARTHEST * radius, Status.STEP_TOO_LONG))
        for condition, flag in conditions:
            flags = flags | jnp.where(condition, int(flag), 0)
    finite = jnp.isfinite(state.position.squared_norm() + state.orientation.w + state.velocity.squared_norm())
    return jnp.where(finite, flags, int(Status.NOT_FINITE) | (flags & int(Status.SEARCH_OVERFLOW)))


def reservations(report: dict[str, Array]) -> Array:
    """Bits of `Status` that an effect's report says by itself, whatever moves."""
    flags = jnp.zeros((), int)
    for name, flag in RESERVATIONS.items():
        if name in report:
            flags = flags | jnp.where(report[name] > 0, int(flag), 0)
    return flags
