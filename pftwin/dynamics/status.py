"""Flags for the reliability of each frame of a motion, their descriptions, and the conditions that raise them."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

from pftwin.base.spatial import Scalar
from pftwin.dynamics.state import State, System
from pftwin.model.effects.base import Instant
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from pftwin.dynamics.equilibrium import Solution

FARTHEST = 0.25  # fraction of the button's radius; a longer displacement within one step may skip a contact
MOST_TURN = 0.3  # largest rotation within one step for which the update of the orientation is exact [rad]
MOST_CREATED = 0.02  # created energy as a fraction of the largest change of energy; for steps above 1 ms, per ms
MOST_SO_FAR = 0.2  # created energy as a fraction of the largest change so far
LEAST_CREATED = 1e-6  # smaller amounts of created energy are ignored [J]
ALLOWED_PATH_ERROR = 1e-3  # error of a frame that is not flagged [m]
MOST_PATH_ERROR = ALLOWED_PATH_ERROR / 2  # larger estimates are flagged, as the error may be twice the estimate
MOST_FORCE_ERROR, MOST_ERROR_SHARE = 5.0, 0.2  # [N], and as a fraction of the largest contact force
DEEPEST = 0.05  # fraction of the button's radius; a deeper indentation is not a small deformation


class Status(enum.IntFlag):
    """Flags for the reliability of a frame; 0 means no objection."""

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
    INACCURATE = 512
    FACETS_INACCURATE = 1024
    END_WITHIN_WRAP = 2048
    PEAK_UNKNOWN = 4096

    def describe(self) -> str:
        """Description of the flags."""
        if not self:
            return "ok"
        return "; ".join(_WORDS[flag] for flag in Status if flag in self)


_FORCE = f"{MOST_FORCE_ERROR:g} N or {MOST_ERROR_SHARE:.0%} of the largest"
_WORDS = {
    Status.NO_CONTACT: "the button touches nothing",
    Status.LEFT_PATCH: "a loaded contact lies outside the fitted surface (extrapolated), or"
    " reaches over the rim of the mesh",
    Status.DEEP_INDENTATION: f"indentation above {DEEPEST:.0%} of the button's radius, or deeper than the"
    " search measures: the step is too long or the contact law too soft",
    Status.NOT_FINITE: "not finite: the step is too long, or a load could not be computed",
    Status.STEP_TOO_LONG: "the patella moves or turns too far within one step, or a step is unstable or did not"
    " converge: take shorter steps",
    Status.SEARCH_OVERFLOW: "the contact search ran out of room or did not converge: a contact may be wrong",
    Status.SNAPPED: "the patella lost its equilibrium and snapped to another one; the duration of the snap is not"
    " computed",
    Status.ENERGY_FROM_NOWHERE: "energy has increased by more than the work done: the step is too long, or forces are"
    " not conservative, as those of coarse meshes",
    Status.INACCURATE: "the estimated error of the time steps, or of rounding at the start, exceeds"
    f" {1e3 * MOST_PATH_ERROR:g} mm in position, or {_FORCE} in contact force: take shorter steps, or use float64",
    Status.FACETS_INACCURATE: f"the estimated error of the time steps exceeds {_FORCE} in the force on one facet:"
    " take shorter steps, or use the sum of both facets",
    Status.END_WITHIN_WRAP: "an end of a line lies inside its wrapping obstacle, so the line runs straight through it:"
    " move the end or make the obstacle smaller",
    Status.PEAK_UNKNOWN: "the estimated error of the largest contact force is as large as this force itself: take"
    " shorter steps",
    Status.START_NOT_IN_EQUILIBRIUM: "the run did not start from a converged equilibrium",
}

FLAGS = tuple(flag for flag in Status if flag)


def status_facts(flags: ArrayLike) -> dict[str, Any]:
    """Entries on reliability for a command's JSON, from flags of frames (n,): description, and frames per flag."""
    found = np.asarray(flags, dtype=np.int64)
    return status_facts_of_counts([np.count_nonzero(found & int(flag)) for flag in FLAGS])


def status_facts_of_counts(counts: ArrayLike) -> dict[str, Any]:
    """As `status_facts`, from the number of frames with each of `FLAGS`, (flags,)."""
    frames = {flag: int(count) for flag, count in zip(FLAGS, np.asarray(counts), strict=True)}
    return {
        "status": Status(sum(flag for flag, count in frames.items() if count)).describe(),
        "status_frames": {str(flag.name).lower(): count for flag, count in frames.items()},
    }


RESERVATIONS = {  # flags of observables, raised where these are positive
    "off_patch": Status.LEFT_PATCH,
    "at_rim": Status.LEFT_PATCH,
    "overflow": Status.SEARCH_OVERFLOW,
    "too_deep": Status.DEEP_INDENTATION,
}


def status_of_all(
    status: Array,
    start: Solution,
    energies: tuple[Scalar, dict[str, Scalar], Scalar] | None,
    step: Scalar,
    snaps: Array | None,
) -> Array:
    """Status of every frame (n,), including flags that follow from the start and from other frames.

    Args:
        status: status of each frame alone (n,).
        start, step: initial equilibrium, and the step [s].
        energies: kinetic energy, energy stored by each effect, and work, (n,) each [J]; None without a ledger.
        snaps: number of snaps since the start (n,), if the integrator counts them.
    """
    badly_started = jnp.where(start.converged(), 0, int(Status.START_NOT_IN_EQUILIBRIUM))
    # If the start is finite and all loads are known, only too long a step can make the motion infinite.
    lost, unknown = ((status & int(flag)) > 0 for flag in (Status.NOT_FINITE, Status.SEARCH_OVERFLOW))
    blown_up = lost & ~lost[0] & ~unknown.any()
    flags = status | badly_started | jnp.where(blown_up, int(Status.STEP_TOO_LONG), 0)
    if energies is not None:
        created = _created(*energies, step) & ~lost
        flags = flags | jnp.where(created, int(Status.ENERGY_FROM_NOWHERE), 0)
    if snaps is not None:
        flags = flags | jnp.where(jnp.diff(snaps, prepend=0) > 0, int(Status.SNAPPED), 0)
    return flags


def _created(kinetic: Scalar, stored: dict[str, Scalar], work: Scalar, step: Scalar) -> Array:
    """Whether kinetic plus stored energy minus work has risen above an earlier value by a frame, (n,).

    Heat can only reduce it, so that its sum is not needed; the error of the work is of second order in the step.
    """
    changes = [kinetic, work, *(energy - energy[0] for energy in stored.values())]
    total = sum(stored.values(), start=kinetic)
    left = total - work
    rise = left - jax.lax.cummin(left)
    moving, size = (
        jnp.where(jnp.isfinite(x), x, 0.0) for x in (jnp.abs(jnp.stack(changes)).max(axis=0), jnp.abs(total))
    )
    # A fraction of the largest change of all frames or, if the motion blows up later, of the largest change so far.
    most = jnp.minimum(MOST_CREATED * moving.max(), MOST_SO_FAR * jax.lax.cummax(moving))
    rounding = 1000 * jnp.finfo(left.dtype).eps * jax.lax.cummax(size)
    return jax.lax.cummax(rise) > jnp.maximum(1.0, step / 1e-3) * most + rounding + LEAST_CREATED


def status_of_frame(
    scene: Scene, reports: dict[str, dict[str, Array]], state: State, step: Scalar, residual: Scalar | None
) -> Array:
    """Flags of one frame alone, () int, bits of `Status`; `reports` contains the reports of the effects by name.

    `residual` is that of the step's equations, if the integrator reports it.
    """
    too_long = step * state.spin.norm() > MOST_TURN
    if residual is not None:
        too_long = too_long | (residual > 0)
    flags, touching = jnp.where(too_long, int(Status.STEP_TOO_LONG), 0), []
    for effect in scene.effects:
        report = reports[effect.name]
        flags = flags | reservations(report)
        contact = effect.contact_role()
        if contact is None:
            continue
        touching.append(report["force"] > 0)
        radius = contact.button_radius()
        conditions = [
            (step * state.velocity.norm() > FARTHEST * radius, Status.STEP_TOO_LONG),
        ]
        if "indentation_medial" in report:
            deepest = jnp.fmax(report["indentation_medial"], report["indentation_lateral"])
            conditions.append((deepest > DEEPEST * radius, Status.DEEP_INDENTATION))
        for condition, flag in conditions:
            flags = flags | jnp.where(condition, int(flag), 0)
    if touching:  # one of several contacts is enough
        flags = flags | jnp.where(jnp.stack(touching).any(), 0, int(Status.NO_CONTACT))
    finite = jnp.isfinite(state.position.squared_norm() + state.orientation.w + state.velocity.squared_norm())
    return jnp.where(finite, flags, int(Status.NOT_FINITE) | (flags & int(Status.SEARCH_OVERFLOW)))


def status_of_lines(system: System, now: Instant) -> Array:
    """Flag of lines that run straight through their obstacle at an instant, () int; 0 if there are none."""
    lines = [line for e in system.effects if (line := e.line_element()) is not None and line.wrap is not None]
    flags = jnp.zeros((), int)
    for line in lines:
        within = jnp.any(line.depth_in_wrap(now) > 0)
        flags = flags | jnp.where(within, int(Status.END_WITHIN_WRAP), 0)
    return flags


def reservations(report: dict[str, Array]) -> Array:
    """Bits of `Status` from an effect's report."""
    flags = jnp.zeros((), int)
    for name, flag in RESERVATIONS.items():
        if name in report:
            flags = flags | jnp.where(report[name] > 0, int(flag), 0)
    return flags
