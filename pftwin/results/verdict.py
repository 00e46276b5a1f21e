"""Whether a motion may be spoken of: the one judgement behind every statement about tracking.

A motion may be spoken of if it starts in equilibrium, is finite, touches the trochlea where its scene has one, and no
frame is flagged as untrustworthy. Everything that speaks of one (summaries, files, pages, fits, predictions) asks here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pftwin.dynamics.status import FLAGS, Status

if TYPE_CHECKING:
    from xarray import Dataset

INVALID = "INVALID"
# Flags that a motion may have, and the share of its frames up to which it may have them; of any other, not one frame.
ALLOWED = {
    Status.NO_CONTACT: 0.5,  # beyond, what is called tracking is mostly a patella in the air
    Status.LEFT_PATCH: 1.0,  # true of the motion: the surface is continued there
    Status.SNAPPED: 1.0,  # true of a motion without inertia
    Status.INACCURATE: 0.1,  # an impact or a change of facets takes a few frames; beyond, the steps are too long
    Status.FACETS_INACCURATE: 1.0,  # the sum of both facets' forces may be good; where it is not, INACCURATE says so
}
REMARKS = Status.LEFT_PATCH  # what is said of a sound motion in one line at the end
# In the order in which they are told: what comes first is why the others follow.
_TOLD = (Status.START_NOT_IN_EQUILIBRIUM, Status.NOT_FINITE, Status.NO_CONTACT)
IN_ORDER = (*_TOLD, *(flag for flag in FLAGS if flag not in _TOLD))


class Verdict(NamedTuple):
    """Why a motion may not be spoken of; no reasons: it may."""

    reasons: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether the motion may be spoken of."""
        return not self.reasons

    def describe(self) -> str:
        """ "valid", or "INVALID" and why."""
        return "valid" if self.valid else f"{INVALID}: {'; '.join(self.reasons)}"


def most_frames(flag: Status, frames: int) -> int:
    """How many frames of a motion of so many may have a flag."""
    return int(ALLOWED.get(flag, 0.0) * frames)


def is_invalid(counts: Any, frames: int) -> Any:
    """Whether motions may not be spoken of, (...,), from how many frames have each of `FLAGS`, (..., flags).

    Of numpy's arrays and of JAX's, traced ones too.
    """
    broken = counts[..., 0] > most_frames(FLAGS[0], frames)
    for i, flag in enumerate(FLAGS[1:], start=1):
        broken = broken | (counts[..., i] > most_frames(flag, frames))
    return broken


def verdict_of(flags: ArrayLike, more: tuple[str, ...] = ()) -> Verdict:
    """The verdict on a motion from the flags of its frames, (n,) bits of `Status`, and from further reasons."""
    found = np.asarray(flags, dtype=np.int64)
    said = verdict_of_counts([np.count_nonzero(found & int(flag)) for flag in FLAGS], found.size)
    return Verdict((*said.reasons, *more))


def verdict_of_counts(counts: ArrayLike, frames: int) -> Verdict:
    """The verdict on a motion of so many frames, from how many have each of `FLAGS`, (flags,)."""
    found = {flag: int(count) for flag, count in zip(FLAGS, np.asarray(counts), strict=True)}
    reasons = []
    for flag in IN_ORDER:
        if found[flag] > most_frames(flag, frames):
            everywhere = flag is Status.START_NOT_IN_EQUILIBRIUM
            reasons.append(flag.describe() if everywhere else f"{flag.describe()} ({found[flag]} of {frames} frames)")
    return Verdict(tuple(reasons))


def verdict_of_file(data: Dataset) -> Verdict:
    """The verdict on the motion in a result's dataset, as it was saved; of an older file from its status."""
    said = str(data.attrs.get("verdict", ""))
    if said.startswith(f"{INVALID}: "):
        return Verdict((said.removeprefix(f"{INVALID}: "),))
    return Verdict() if said else verdict_of(data["status"].values)
