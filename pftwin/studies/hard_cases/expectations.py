"""Checks of what single cases expect: symmetry, rest, a load at the end."""

from __future__ import annotations

import numpy as np

from pftwin.studies.hard_cases.ground import axis_below
from pftwin.studies.hard_cases.look import Floats, Look


def symmetric(look: Look) -> str | None:
    """A scene symmetric about y = 0 stays so."""
    if not look.case.expected.symmetric or look.contact in ("contours", "volume"):  # a mesh's diagonals are not
        return None
    p, q = (np.asarray(a, np.float64)[look.clean()] for a in _poses(look))
    off = max(np.abs(p[:, 1]).max(initial=0.0), np.abs(q[:, [1, 3]]).max(initial=0.0))
    return f"leaves the plane of symmetry by {off:.1g}" if off > look.tolerance.symmetric else None


def still(look: Look) -> str | None:
    """What has to stay where it is does."""
    if not look.case.expected.still:
        return None
    p, q = (np.asarray(a, np.float64) for a in _poses(look))
    off = max(np.abs(p - p[0]).max(), 0.02 * np.abs(q - q[0]).max())
    return f"moves by {1e3 * off:.2g} mm" if off > look.tolerance.still else None


def at_end(look: Look) -> str | None:
    """Loaded at the last frame, or not: by more than the rounding of its button's place in the surface's chart gives.

    Where it touches that place is the button's radius away from the chart's plane, or that and the plane from the axis.
    """
    wanted, force = look.case.expected.force_at_end, look.report("force")[-1]
    law, size = look.knee.law, look.knee.radius + axis_below(look.knee.ground, look.contact)
    rounding = np.finfo(np.asarray(look.run.states.position.x).dtype).eps * size
    if wanted is None or (force > law.stiffness * rounding**law.exponent) == wanted:
        return None
    return f"a force of {force:.2g} N at the end"


def _poses(look: Look) -> tuple[Floats, Floats]:
    states = look.run.states
    return np.asarray(states.position.array(), np.float64), np.asarray(states.orientation.array(), np.float64)
