"""Error estimates of a run's path and forces at every frame, from runs of the same scene with other steps.

If errors are proportional to the step to the power p, the difference of two runs whose steps have the ratio r is
r^p - 1 times the error of the finer run, and 1 - r^-p times that of the coarser. Contacts that open and close reduce
the order of an integrator: for paths, p is half of its declared order, at most 1. A force jumps where a contact opens,
so with any integrator its error at a single frame falls at best with the square root of the step: for forces, p = 1/2.

Two runs can agree by chance where contacts chatter. So `pftwin.simulate` doubles a first estimate, and raises later
ones to at least what the previous pair, with steps twice as long, predicts.

Arrays are NumPy's on the host and JAX's in a compiled program; `xp` is the module to use.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pftwin.base.leaves import host_array
from pftwin.base.spatial import Vec3
from pftwin.dynamics.observe import Observation
from pftwin.dynamics.status import MOST_ERROR_SHARE, MOST_FORCE_ERROR, MOST_PATH_ERROR, Status

COVERED_DISTANCE = 0.02  # distance from the tracked point of the patella's points that the path's error covers [m]
FORCE_POWER = 0.5  # assumed order of convergence of forces at single frames
LEAST_FORCE = 0.05  # errors of force below this are never flagged [N]


class Course(NamedTuple):
    """Path and contact forces of the patella at the frames; leading batch axes are allowed on the host."""

    center: Any  # (..., n, 3) tracked point, femur frame [m]
    quaternion: Any  # (..., n, 4)
    force: Any  # (..., n, 3) contact force on the patella [N]; zero without a contact
    medial: Any  # (..., n) size of the force on each facet [N]
    lateral: Any

    @classmethod
    def of(cls, observation: Observation, contact: str | None) -> Course:
        """From observations, on the host; `contact` is the name of the scene's contact, None without one."""
        center, turn = host_array(observation.center), host_array(observation.patella.orientation)
        nothing = np.zeros(center.shape[:-1])
        report: dict[str, Any] = {} if contact is None else observation.effects[contact]
        force = host_array(Vec3(*(report.get(f"force_{axis}", nothing) for axis in "xyz")))
        facets = (np.asarray(report.get(f"force_{facet}", nothing), float) for facet in ("medial", "lateral"))
        return cls(center, turn, force, *facets)


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated errors of a run at every frame (n,), infinite if unknown. These are not bounds: see the module."""

    path: Any  # of the position of any point of the patella within 20 mm of the tracked one [m]
    contact_force: Any  # norm of the error of the contact force [N]
    medial_facet: Any  # of the magnitude of the force on each facet [N]
    lateral_facet: Any
    force: Any  # size of the run's contact force itself (n,) [N]
    most_force: Any  # error of a force above which it is flagged, () [N]

    @property
    def errors(self) -> tuple[Any, ...]:
        """Errors of path, contact force, and force on the medial and the lateral facet."""
        return self.path, self.contact_force, self.medial_facet, self.lateral_facet

    def with_errors(self, path: Any, contact_force: Any, medial_facet: Any, lateral_facet: Any) -> ErrorEstimate:
        """An estimate of these errors of the same run."""
        forces = {"contact_force": contact_force, "medial_facet": medial_facet, "lateral_facet": lateral_facet}
        return replace(self, path=path, **forces)

    def times(self, path: Any, force: Any) -> ErrorEstimate:
        """The estimate with the errors of path and forces multiplied by factors."""
        length, *forces = self.errors
        return self.with_errors(path * length, *(force * f for f in forces))

    def with_start(self, off: float) -> ErrorEstimate:
        """The estimate with an error of the initial position `off` [m] added to the path at every frame."""
        return replace(self, path=self.path + off)

    @property
    def unknown(self) -> ErrorEstimate:
        """The estimate with infinite errors at every frame."""
        return self.with_errors(*(np.full_like(x, np.inf) for x in self.errors))

    def or_larger(self, other: ErrorEstimate) -> ErrorEstimate:
        """The larger of two estimates at each frame."""
        return self.with_errors(*map(np.maximum, self.errors, other.errors))

    @property
    def flags(self) -> Any:
        """Bits of `Status` for each frame (n,)."""
        return self.flags_beyond(MOST_PATH_ERROR)

    def flags_beyond(self, most_path: float) -> Any:
        """Bits of `Status` (n,) for errors of the path above `most_path` [m] or of a force above `most_force`, and
        where the force is largest, if its error is as large."""
        most, error = self.most_force, self.contact_force
        unknown = (self.force >= self.force.max()) & (error >= self.force) & (error > LEAST_FORCE) & (error < np.inf)
        off = (self.path > most_path) | (error > most)
        unshared = (self.medial_facet > most) | (self.lateral_facet > most)
        pairs = (off, Status.INACCURATE), (unshared, Status.FACETS_INACCURATE), (unknown, Status.PEAK_UNKNOWN)
        return sum(where.astype(np.int32) * int(flag) for where, flag in pairs)

    @property
    def largest(self) -> dict[str, Any]:
        """The largest error of all frames for each quantity."""
        names = ("path", "contact_force", "medial_facet", "lateral_facet")
        return {name: values.max() for name, values in zip(names, self.errors, strict=True)}

    def describe(self) -> str:
        """The largest errors of all frames, in words."""
        path, force, *facets = self.largest.values()
        return f"{1e3 * path:.2g} mm of path, {force:.2g} N of contact force, {max(facets):.2g} N on one facet"

    @property
    def small(self) -> bool:
        """Whether no frame is flagged."""
        return not self.flags.any()


def error_of(run: Course, other: Course, order: float, ratio: Any, xp: Any = np) -> ErrorEstimate:
    """Estimates the errors of `run` from another run of the same scene with an integrator of order `order`.

    `ratio` is the other's step over the run's: 2 if the other has half as many steps, 1/2 if it has twice as many.
    """
    found = course_difference(run, other, xp)
    return found.times(1 / abs(ratio ** path_power(order) - 1), 1 / abs(ratio**FORCE_POWER - 1))


def course_difference(a: Course, b: Course, xp: Any = np) -> ErrorEstimate:
    """Difference of a run from another at every frame; infinite where one is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        moved = _length(a.center - b.center, xp)
        cosine = xp.abs(_dot(a.quaternion, b.quaternion))
        turned = 2 * xp.arctan2(xp.sqrt(xp.clip(1 - cosine**2, 0, 1)), cosine)
        force = _length(a.force - b.force, xp)
        found = moved + COVERED_DISTANCE * turned, force, xp.abs(a.medial - b.medial), xp.abs(a.lateral - b.lateral)
        sizes = [_length(x.force, xp) for x in (a, b)]
    peaks = [xp.where(xp.isfinite(x), x, 0.0).max() for x in sizes]
    most = xp.clip(MOST_ERROR_SHARE * xp.minimum(*peaks), LEAST_FORCE, MOST_FORCE_ERROR)
    return ErrorEstimate(*(xp.where(xp.isfinite(x), x, xp.inf) for x in found), force=sizes[0], most_force=most)


def _dot(a: Any, b: Any) -> Any:
    """Dot product over the last axis, term by term: the rounding of a reduction depends on the size of the batch."""
    products = [a[..., i] * b[..., i] for i in range(a.shape[-1])]
    return sum(products[1:], start=products[0])


def _length(a: Any, xp: Any) -> Any:
    return xp.sqrt(_dot(a, a))


def after_halving(before: ErrorEstimate, order: float) -> ErrorEstimate:
    """The expected error with half the step."""
    return before.times(2 ** -path_power(order), 2**-FORCE_POWER)


def path_power(order: float) -> float:
    """Assumed order of convergence of the path with an integrator of order `order`."""
    return min(1.0, order / 2)
