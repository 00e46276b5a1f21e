"""A left knee is mirrored on input: inside, every knee is a right one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.poses import PoseSeries


def mirror_left_markers(markers: MarkerTrajectories, *, medial_lateral: str) -> MarkerTrajectories:
    """Markers mirrored about the sagittal plane: the coordinate on the laboratory's medial-lateral axis changes sign.

    Args:
        markers: of a left knee.
        medial_lateral: "x", "y" or "z".
    """
    return replace(
        markers, positions=markers.positions * _reflection(medial_lateral), source=f"{markers.source} (mirrored)"
    )


def mirror_left_poses(poses: PoseSeries, *, medial_lateral: str, body_medial_lateral: str) -> PoseSeries:
    """Poses mirrored about the sagittal plane.

    p' = S p, R' = S R S_b with the reflections S in the parent's and S_b in the body's axes.
    The body's own geometry must be mirrored along `body_medial_lateral` too.

    Args:
        poses: of a body of a left knee.
        medial_lateral: the parent frame's medial-lateral axis, "x", "y" or "z".
        body_medial_lateral: the body frame's medial-lateral axis.
    """
    parent, body = _reflection(medial_lateral), _reflection(body_medial_lateral)
    return PoseSeries.from_matrices(
        poses.times,
        poses.positions * parent,
        parent[:, None] * poses.matrices() * body,
        residual_rms=poses.residual_rms,
        source=f"{poses.source} (mirrored)",
    )


def _reflection(axis: str) -> NDArray[np.float64]:
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}", where="medial_lateral", expected="'x', 'y' or 'z'")
    signs = np.ones(3)
    signs["xyz".index(axis)] = -1.0
    return signs
