"""Tables of results in the axes of the International Society of Biomechanics: x anterior, y proximal, z to the right.

The axes of results are x proximal, y lateral, z anterior, and a left knee is computed as its mirror image. In ISB axes
it is a left knee again.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError

PFTWIN, ISB = "pftwin", "isb"
# Rows: the ISB's axes x, y, z, for a right knee, in the axes of results (Wu et al. 2002, J Biomech 35:543).
AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def check_axes(axes: str) -> str:
    """Returns the name of the axes; InputError if it is unknown."""
    if axes not in (PFTWIN, ISB):
        raise InputError(f"found {axes!r}", where="axes", expected=f"{PFTWIN} or {ISB}")
    return axes


def describe(left: bool) -> str:
    """The axes in words, for the header of a file."""
    side = "left" if left else "right"
    return f"Axes: ISB (Wu et al. 2002), {side} knee: x anterior, y proximal, z to the right"


def in_isb_axes(columns: Mapping[str, Floats], left: bool) -> dict[str, Floats]:
    """Columns (n,) with all vectors (NAME_x, NAME_y, NAME_z) and rotations (NAME_qx, NAME_qy, NAME_qz) in ISB axes.

    Vectors are positions and forces. The axis of a rotation turns the other way in a mirror image. All other columns,
    such as lengths and clinical angles, are the same in any axes.
    """
    turn = np.diag([1.0, 1.0, -1.0 if left else 1.0]) @ AXES
    turned = dict(columns)
    for start, matrix in (("_", turn), ("_q", np.linalg.det(turn) * turn)):
        for name in (n.removesuffix(f"{start}x") for n in columns if n.endswith(f"{start}x")):
            parts = [f"{name}{start}{axis}" for axis in "xyz"]
            if all(part in columns for part in parts):
                turned |= zip(parts, matrix @ np.stack([columns[part] for part in parts]), strict=True)
    return turned
