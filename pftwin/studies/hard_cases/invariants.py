"""Checks of invariants of all runs and of the expectations of cases; each returns None or describes the fault."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.leaves import host_array
from pftwin.dynamics.status import DEEPEST, Status
from pftwin.studies.hard_cases.case import UNKNOWN, HardCase
from pftwin.studies.hard_cases.contacts import MESHES
from pftwin.studies.hard_cases.programs import CaseRun

if TYPE_CHECKING:
    from pftwin.studies.hard_cases.case import RigNumbers
    from pftwin.studies.hard_cases.knee import KneeNumbers

GEOMETRY = Status.NO_CONTACT | Status.LEFT_PATCH | Status.DEEP_INDENTATION  # flags with separate checks
# Flags of step errors, which are compared with a converged run.
ERRORS = Status.INACCURATE | Status.FACETS_INACCURATE | Status.PEAK_UNKNOWN


class CheckTolerances(NamedTuple):
    """Tolerances of the checks for a float type."""

    unit: float  # of the quaternion's norm
    created: float  # created energy relative to the largest energy; times the step in ms if that is above 1
    least: float  # smaller energies are not judged [J]
    place: float  # between depths from two methods [m]
    symmetric: float  # [m] and quaternion components
    same: float  # between two runs that must agree [m] and quaternion components
    still: float  # of the position if nothing may move [m]


TOLERANCES = {
    "float64": CheckTolerances(1e-9, 0.02, 1e-6, 2e-5, 1e-7, 1e-7, 1e-6),
    "float32": CheckTolerances(1e-5, 0.02, 1e-4, 5e-5, 1e-3, 2e-3, 2e-4),
}


class Look(NamedTuple):
    """One case's run on the host, with the data that the checks need."""

    case: HardCase
    knee: KneeNumbers | RigNumbers
    contact: str
    run: CaseRun
    tolerance: CheckTolerances
    step: float  # [s]
    depth: Floats  # (n,) penetration of the button, by exhaustive search [m]
    inertia: bool = True  # whether the motion has inertia, hence kinetic energy

    @property
    def flags(self) -> NDArray[np.int64]:
        """Flags of the frames, (n,) bits of `Status`."""
        return np.asarray(self.run.observation.status, dtype=np.int64)

    def report(self, name: str) -> Floats:
        """Returns an observable of the contact (n,)."""
        return np.asarray(self.run.observation.effects["contact"][name], dtype=np.float64)

    def kinetic(self) -> Floats:
        """Returns the kinetic energy (n,) [J]; zero for a motion without inertia."""
        energy = np.asarray(self.run.observation.kinetic_energy, np.float64)
        return energy if self.inertia else 0.0 * energy

    def clean(self) -> NDArray[np.bool_]:
        """Returns whether each frame precedes the first that the run itself rejects (n,)."""
        return np.cumsum(self.flags & int(UNKNOWN)) == 0

    def indentation(self) -> Floats:
        """Returns the larger indentation of the two facets (n,) [m]."""
        return np.fmax(self.report("indentation_medial"), self.report("indentation_lateral"))


def finite(look: Look) -> str | None:
    """Checks that all observations are finite in all frames; reports of a facet may be NaN without contact."""
    states, ledger = look.run.states, look.run.ledger
    arrays = [host_array(a) for a in (states.position, states.orientation, states.velocity, states.spin)]
    arrays += [ledger.work, ledger.heat, look.run.observation.kinetic_energy, look.report("force")]
    bad = ~np.logical_and.reduce([np.isfinite(np.asarray(a)).reshape(len(look.flags), -1).all(axis=1) for a in arrays])
    return f"not finite from frame {np.argmax(bad) + 1}" if bad.any() else None


def unit_quaternion(look: Look) -> str | None:
    """Checks that the quaternion has norm 1."""
    off = np.abs(np.linalg.norm(host_array(look.run.states.orientation), axis=1) - 1)
    worst = off[look.clean()].max(initial=0.0)
    return f"quaternion's length off by {worst:.1g}" if not worst <= look.tolerance.unit else None


def flags_allowed(look: Look) -> str | None:
    """Checks that the run has the required flags and no others that are not allowed, except geometric flags."""
    every = Status(int(np.bitwise_or.reduce(look.flags)))
    expected = look.case.expected
    if expected.must & ~every:
        return f"flag missing: {(expected.must & ~every).describe()}"
    allowed = expected.may | expected.must | GEOMETRY | ERRORS
    if not look.inertia:
        allowed |= Status.SNAPPED  # reported, so not wrong
    more = every & ~allowed
    return f"flag not expected: {more.describe()}" if more else None


def energy(look: Look) -> str | None:
    """Checks that T + V - work never rises above its smallest earlier value.

    Heat can only lower it, so heat is not counted.
    """
    observation, ledger = look.run.observation, look.run.ledger
    stored = [np.asarray(v, np.float64) for v in observation.potential_energy.values()]
    kinetic, work, clean = look.kinetic(), np.asarray(ledger.work, np.float64), look.clean()
    left = (kinetic + sum(stored) - work)[clean]
    parts = [kinetic, *(v - v[0] for v in stored), work]
    scale = max((float(np.abs(p[clean]).max(initial=0.0)) for p in parts), default=0.0)
    created = (left - np.minimum.accumulate(left)).max(initial=0.0)
    longer = max(1.0, look.step / 1e-3)  # the created energy grows with the step
    bound = look.tolerance.created * longer * scale + look.tolerance.least
    return f"{created:.2g} J from nowhere, {100 * created / scale:.1f} % of the largest" if created > bound else None


def penetration(look: Look) -> str | None:
    """Checks that the energy that the indentation stores by Hertz's law does not exceed the available energy."""
    law = look.knee.law
    depth = np.maximum(np.nan_to_num(look.indentation()), 0.0)
    stored = law.stiffness * depth ** (law.exponent + 1) / (law.exponent + 1)
    observation, work = look.run.observation, np.asarray(look.run.ledger.work, np.float64)
    others = [np.asarray(v, np.float64) for n, v in observation.potential_energy.items() if n != "contact"]
    total = look.kinetic() + sum(np.asarray(v, np.float64) for v in observation.potential_energy.values())
    available = total[0] + np.maximum(work, 0.0) - sum(others)
    clean = look.clean()
    scale = float(np.max(np.abs(total[clean]), initial=0.0))
    over = (0.5 * stored - available)[clean]  # a contact shared by both facets counts only once
    worst = over.max(initial=0.0)
    return f"indentation stores {worst:.2g} J too much" if worst > look.tolerance.least + 0.02 * scale else None


def place(look: Look) -> str | None:
    """Checks that there is force exactly where an exhaustive search finds contact, at the same depth."""
    depth, found, force = look.depth, look.indentation(), look.report("force")
    clean, near = look.clean(), look.tolerance.place * max(1.0, look.knee.radius / 0.022)
    near = near + (0.0105 * look.knee.radius if look.contact == "contours" else 0.0)  # the button's flat triangles
    distant = clean & (force > 0) & (depth < -near)
    if distant.any():
        return f"force at a distance of {1e3 * -depth[distant].min():.2g} mm"
    if look.contact in MESHES:  # their indentation differs from the depth at the closest point
        # The law's damping can cancel the force on the way out, so an indentation without force is not a miss.
        missed = clean & (force <= 0) & ~(found > 0) & (depth > np.maximum(near, DEEPEST * look.knee.radius))
        return f"no force {1e3 * depth[missed].max():.2g} mm deep" if missed.any() else None
    off = np.where(clean & ((depth > near) | (found > near)), np.abs(np.nan_to_num(found) - depth), 0.0)
    k = int(np.argmax(off))
    if off[k] > near + 0.02 * abs(depth[k]):
        return f"frame {k + 1}: {1e3 * found[k]:.3g} mm deep where it is {1e3 * depth[k]:.3g} mm"
    return None


def geometry_flags(look: Look) -> str | None:
    """Checks that NO_CONTACT and DEEP_INDENTATION are flagged exactly where an exhaustive search finds them."""
    depth, clean = look.depth, look.clean()
    near = look.tolerance.place * max(1.0, look.knee.radius / 0.022)
    if look.contact in MESHES:
        near = near + 0.0105 * look.knee.radius
    none, deep = ((look.flags & int(f)) > 0 for f in (Status.NO_CONTACT, Status.DEEP_INDENTATION))
    limit = DEEPEST * look.knee.radius
    wrong = {
        # The law's damping can cancel the force on the way out, so an indentation without force is not a miss.
        "says no contact, touches": clean & none & (depth > near) & ~(look.indentation() > 0),
        "touches nothing, does not say so": clean & ~none & (depth < -near),
        "too deep, does not say so": clean & ~deep & (depth > limit + 2 * near),
        "says too deep, is not": clean & deep & (depth < limit - 2 * near),
    }
    if look.contact in MESHES:
        del wrong["says too deep, is not"], wrong["too deep, does not say so"]  # meshes use area or volume, not depth
    said = [f"frame {np.argmax(w) + 1}: {words}" for words, w in wrong.items() if w.any()]
    return said[0] if said else None


def symmetric(look: Look) -> str | None:
    """Checks that a scene that is symmetric about y = 0 stays symmetric."""
    if not look.case.expected.symmetric or look.contact in MESHES:  # the diagonals of a mesh are not symmetric
        return None
    p, q = (host_array(a)[look.clean()] for a in (look.run.states.position, look.run.states.orientation))
    off = max(np.abs(p[:, 1]).max(initial=0.0), np.abs(q[:, [1, 3]]).max(initial=0.0))
    return f"leaves the plane of symmetry by {off:.1g}" if off > look.tolerance.symmetric else None


def stays_in_place(look: Look) -> str | None:
    """Checks that a patella that must not move stays in place."""
    if not look.case.expected.still:
        return None
    p, q = host_array(look.run.states.position), host_array(look.run.states.orientation)
    off = max(np.abs(p - p[0]).max(), 0.02 * np.abs(q - q[0]).max())
    return f"moves by {1e3 * off:.2g} mm" if off > look.tolerance.still else None


def at_end(look: Look) -> str | None:
    """Checks whether the button is loaded at the last frame, by more than rounding of its position causes.

    The rounding scales with the distance of the button's centre from the chart's plane or axis.
    """
    wanted, force = look.case.expected.force_at_end, look.report("force")[-1]
    law, size = look.knee.law, look.knee.radius + look.knee.axis_below(look.contact)
    rounding = np.finfo(np.asarray(look.run.states.position.x).dtype).eps * size
    if wanted is None or (force > law.stiffness * rounding**law.exponent) == wanted:
        return None
    return f"a force of {force:.2g} N at the end"


CHECKS: tuple[Callable[[Look], str | None], ...] = (
    finite,
    flags_allowed,
    unit_quaternion,
    energy,
    penetration,
    place,
    geometry_flags,
    symmetric,
    stays_in_place,
    at_end,
)
