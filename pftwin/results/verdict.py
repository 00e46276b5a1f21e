"""Validity of a simulated motion.

A motion is valid if it starts in equilibrium, is finite, keeps contact with the trochlea (if the scene has one) and no
status flag occurs in more frames than `ALLOWED`. Summaries, files, pages, fits and predictions all use this verdict.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pftwin.dynamics.status import FLAGS, Status

if TYPE_CHECKING:
    from xarray import Dataset

INVALID = "INVALID"
# Largest share of the frames that may have a flag in a valid motion; any other flag may not occur at all.
ALLOWED = {
    Status.NO_CONTACT: 0.5,  # with a larger share, the patella moves mostly without contact
    Status.LEFT_PATCH: 1.0,  # describes the motion, not an error: the surface is extrapolated there
    Status.SNAPPED: 1.0,  # describes the motion, if it has no inertia
    Status.INACCURATE: 0.1,  # an impact or a change of facets takes a few frames; with more, the steps are too long
    Status.FACETS_INACCURATE: 1.0,  # the total force may still be accurate; INACCURATE flags it if it is not
}
REMARKS = Status.LEFT_PATCH  # reported as a remark at the end of the summary
# Order of the reasons: these flags come first because they cause the others.
_CAUSES = (Status.START_NOT_IN_EQUILIBRIUM, Status.NOT_FINITE, Status.NO_CONTACT)
IN_ORDER = (*_CAUSES, *(flag for flag in FLAGS if flag not in _CAUSES))


class Verdict(NamedTuple):
    """Reasons that a motion is invalid; empty if it is valid."""

    reasons: tuple[str, ...] = ()
    flags: Status = Status.OK  # flags of frames that are among the reasons

    @property
    def valid(self) -> bool:
        """Whether the motion is valid."""
        return not self.reasons

    def describe(self) -> str:
        """Returns "valid", or "INVALID" and the reasons."""
        return "valid" if self.valid else f"{INVALID}: {'; '.join(self.reasons)}"


def most_frames(flag: Status, frames: int) -> int:
    """Returns in how many of a motion's `frames` a flag may occur."""
    return int(ALLOWED.get(flag, 0.0) * frames)


def is_invalid(counts: Any, frames: int) -> Any:
    """Whether motions are invalid, (...,), from the number of frames with each of `FLAGS`, (..., flags).

    Accepts NumPy and JAX arrays, including traced ones.
    """
    broken = counts[..., 0] > most_frames(FLAGS[0], frames)
    for i, flag in enumerate(FLAGS[1:], start=1):
        broken = broken | (counts[..., i] > most_frames(flag, frames))
    return broken


def verdict_of(flags: ArrayLike, more: tuple[str, ...] = ()) -> Verdict:
    """Returns the verdict on a motion from its frames' flags, (n,) bits of `Status`, and `more` reasons."""
    found = np.asarray(flags, dtype=np.int64)
    said = verdict_of_counts([np.count_nonzero(found & int(flag)) for flag in FLAGS], found.size)
    return Verdict((*said.reasons, *more), said.flags)


def verdict_of_counts(counts: ArrayLike, frames: int) -> Verdict:
    """Returns the verdict on a motion of `frames` frames from the number with each of `FLAGS`, (flags,)."""
    found = {flag: int(count) for flag, count in zip(FLAGS, np.asarray(counts), strict=True)}
    broken = [flag for flag in IN_ORDER if found[flag] > most_frames(flag, frames)]
    everywhere = Status.START_NOT_IN_EQUILIBRIUM
    reasons = (f.describe() + ("" if f is everywhere else f" ({found[f]} of {frames} frames)") for f in broken)
    return Verdict(tuple(reasons), Status(sum(broken)))


def verdict_of_file(data: Dataset) -> Verdict:
    """Returns the verdict saved in a result's dataset; for an older file, computes it from the status flags."""
    said = str(data.attrs.get("verdict", ""))
    if said.startswith(f"{INVALID}: "):
        return Verdict((said.removeprefix(f"{INVALID}: "),))
    return Verdict() if said else verdict_of(data["status"].values)
