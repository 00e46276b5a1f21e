"""How far off a run's path and forces are, frame by frame: told from runs of the same scene with other steps.

Where errors fall with the power p of the step, two runs whose steps have the ratio r are as far apart as r^p - 1 times
the error of the finer one, and 1 - r^-p times that of the coarser. Contacts that open and close cost part of an
integrator's order: for paths p is half of what it declares, at most 1. A force jumps where a contact opens, and at a
single frame it errs with the square root of the step at best, with any integrator: for forces p = 1/2.

Two runs can agree by chance where contacts chatter. So `pftwin.simulate` counts a first estimate double, and has later
ones borne out by the pair before, of steps twice as long.

Arrays are numpy's on the host and JAX's in a compiled program: `xp` is the module that has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pftwin.base.leaves import host_array
from pftwin.base.spatial import Vec3
from pftwin.dynamics.observe import Observation
from pftwin.dynamics.status import MOST_ERROR_SHARE, MOST_FORCE_ERROR, MOST_PATH_ERROR, Status

REACH = 0.02  # of the patella's points that count, from the tracked one [m]
FORCE_POWER = 0.5  # with which errors of forces at single frames fall, at worst
LEAST_FORCE = 0.05  # errors of force below this are never flagged [N]


class Course(NamedTuple):
    """Where the patella is at the frames and what presses on it; on the host leading axes of batches are allowed."""

    center: Any  # (..., n, 3) tracked point, femur frame [m]
    quaternion: Any  # (..., n, 4)
    force: Any  # (..., n, 3) contact force on the patella [N]; zero without a contact
    medial: Any  # (..., n) size of the force on each facet [N]
    lateral: Any

    @classmethod
    def of(cls, seen: Observation, contact: str | None) -> Course:
        """Of what was observed of a scene whose tracked contact has this name, on the host."""
        center, turn = host_array(seen.center), host_array(seen.patella.orientation)
        nothing = np.zeros(center.shape[:-1])
        report: dict[str, Any] = {} if contact is None else seen.effects[contact]
        force = host_array(Vec3(*(report.get(f"force_{axis}", nothing) for axis in "xyz")))
        facets = (np.asarray(report.get(f"force_{facet}", nothing), float) for facet in ("medial", "lateral"))
        return cls(center, turn, force, *facets)


@dataclass(frozen=True)
class ErrorEstimate:
    """Of a run, at every frame (n,); infinite where it is not known. Estimates, not bounds: see above."""

    path: Any  # how far the patella's points within 20 mm of the tracked one may be off [m]
    contact_force: Any  # length of the difference of the contact force [N]
    medial_facet: Any  # of the size of the force on each facet [N]
    lateral_facet: Any
    most_force: Any  # what a force may be off before it is flagged, () [N]

    @property
    def _all(self) -> tuple[Any, ...]:
        return self.path, self.contact_force, self.medial_facet, self.lateral_facet

    def times(self, path: Any, force: Any) -> ErrorEstimate:
        """With factors on lengths and on forces."""
        length, *forces = self._all
        return ErrorEstimate(path * length, *(force * f for f in forces), most_force=self.most_force)

    def with_start(self, off: float) -> ErrorEstimate:
        """With the path off by so much from its start on [m]."""
        return replace(self, path=self.path + off)

    @property
    def unknown(self) -> ErrorEstimate:
        """The same, but infinite at every frame."""
        return ErrorEstimate(*(np.full_like(x, np.inf) for x in self._all), most_force=self.most_force)

    def or_larger(self, other: ErrorEstimate) -> ErrorEstimate:
        """At each frame the larger of two."""
        return ErrorEstimate(*map(np.maximum, self._all, other._all), most_force=self.most_force)

    @property
    def flags(self) -> Any:
        """Bits of `Status` that follow (n,)."""
        return self.flags_beyond(MOST_PATH_ERROR)

    def flags_beyond(self, most_path: float) -> Any:
        """Bits of `Status` (n,) where the path is off by more than this [m], or a force by more than `most_force`."""
        most = self.most_force
        off = (self.path > most_path) | (self.contact_force > most)
        unshared = (self.medial_facet > most) | (self.lateral_facet > most)
        return off.astype(np.int32) * int(Status.INACCURATE) + unshared.astype(np.int32) * int(Status.FACETS_INACCURATE)

    @property
    def largest(self) -> dict[str, Any]:
        """Of all frames, by quantity."""
        names = ("path", "contact_force", "medial_facet", "lateral_facet")
        return {name: values.max() for name, values in zip(names, self._all, strict=True)}

    def describe(self) -> str:
        """The largest of all frames, in words."""
        path, force, *facets = self.largest.values()
        return f"{1e3 * path:.2g} mm of path, {force:.2g} N of contact force, {max(facets):.2g} N on one facet"

    @property
    def small(self) -> bool:
        """Whether nothing is flagged."""
        return not self.flags.any()


def error_of(run: Course, other: Course, order: float, ratio: Any, xp: Any = np) -> ErrorEstimate:
    """Of a run, from another one of the same scene, by an integrator of this order.

    `ratio` is that of the other's step to the run's: 2 where the other has half as many steps, 1/2 where twice as many.
    """
    found = apart(run, other, xp)
    return found.times(1 / abs(ratio ** path_power(order) - 1), 1 / abs(ratio**FORCE_POWER - 1))


def apart(a: Course, b: Course, xp: Any = np) -> ErrorEstimate:
    """How far two runs are apart at every frame; infinite where one is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        moved = _length(a.center - b.center, xp)
        cosine = xp.abs(_dot(a.quaternion, b.quaternion))
        turned = 2 * xp.arctan2(xp.sqrt(xp.clip(1 - cosine**2, 0, 1)), cosine)
        force = _length(a.force - b.force, xp)
        found = moved + REACH * turned, force, xp.abs(a.medial - b.medial), xp.abs(a.lateral - b.lateral)
        sizes = [_length(x.force, xp) for x in (a, b)]
    peaks = [xp.where(xp.isfinite(x), x, 0.0).max() for x in sizes]
    most = xp.clip(MOST_ERROR_SHARE * xp.minimum(*peaks), LEAST_FORCE, MOST_FORCE_ERROR)
    return ErrorEstimate(*(xp.where(xp.isfinite(x), x, xp.inf) for x in found), most_force=most)


def _dot(a: Any, b: Any) -> Any:
    """Over the last axis, number by number: the last bit of a reduction depends on how many members a call has."""
    products = [a[..., i] * b[..., i] for i in range(a.shape[-1])]
    return sum(products[1:], start=products[0])


def _length(a: Any, xp: Any) -> Any:
    return xp.sqrt(_dot(a, a))


def after_halving(before: ErrorEstimate, order: float) -> ErrorEstimate:
    """What an error comes down to with half the step."""
    return before.times(2 ** -path_power(order), 2**-FORCE_POWER)


def path_power(order: float) -> float:
    """With which errors of the path fall, of an integrator of this order."""
    return min(1.0, order / 2)
