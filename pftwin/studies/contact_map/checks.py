"""Whether two meshes, poses and what came of them belong together, in words for the user. Host side."""

from __future__ import annotations

import os
import warnings

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.contact.behind import MutualPlace, mutual_place
from pftwin.geometry.contact.depths import DEEPEST
from pftwin.geometry.mesh.mesh import PLAUSIBLE, UNITS, SurfaceMesh, load_mesh, plausible_units
from pftwin.studies.contact_map.mapping import ContactMap

_LOOKS = 5  # frames that are looked at before anything is computed


def load_pair(
    femur: str | os.PathLike[str], patella: str | os.PathLike[str], *, units: str, patella_units: str | None = None
) -> tuple[SurfaceMesh, SurfaceMesh]:
    """Both meshes in metres.

    Raises:
        InputError: as `load_mesh`; a size that does not suit the units, with the unit that would.
    """
    meshes = []
    for path, unit in ((femur, units), (patella, patella_units or units)):
        mesh = load_mesh(path, units=unit, size=None)
        if not PLAUSIBLE[0] <= mesh.extent <= PLAUSIBLE[1]:
            fitting = plausible_units(mesh.extent / UNITS[unit])
            option = "--patella-units" if meshes else "--units"
            other = " (the femur's mesh suits them: the two are in different units)" if meshes else ""
            raise InputError(
                f"in {unit}, its longest side is {1e3 * mesh.extent:.4g} mm{other}",
                where=path,
                expected=f"between {1e3 * PLAUSIBLE[0]:g} and {1e3 * PLAUSIBLE[1]:g} mm",
                remedy=f"{option} {fitting[0]}" if fitting else "pftwin doctor-mesh",
            )
        meshes.append(mesh)
    return meshes[0], meshes[1]


def check_sides(femur: SurfaceMesh, button: SurfaceMesh, poses: PoseSeries) -> None:
    """Refuse a button that is inside the femur, or never near it, in a few frames all over the recording.

    Raises:
        InputError: more than half of the button behind the femur's surface, or all of it far away, in all of them.
    """
    frames = np.unique(np.linspace(0, poses.times.size - 1, _LOOKS).round().astype(int))
    looks = [_look(femur, button, poses, k) for k in frames]
    if all(look.behind > 0.5 for look in looks):
        raise InputError(
            f"at {poses.times[frames[0]]:g} s {looks[0].behind:.0%} of the button are inside the femur, "
            "and no better at any other time that was looked at",
            where=poses.source,
            expected="poses of the button's mesh frame against the femur's",
            remedy="check that normals point outward (pftwin doctor-mesh), which body is which, and the poses' units",
        )
    nearest = min(look.gap for look in looks)
    if nearest > PLAUSIBLE[1]:
        raise InputError(
            f"button and femur are never nearer than {1e3 * nearest:.0f} mm",
            where=poses.source,
            remedy="check which body is which, and that meshes and poses have the same frames",
        )


def check_outcome(found: ContactMap, poses: PoseSeries) -> None:
    """Refuse a map without any contact to trust; warn of frames that are not to be trusted.

    Raises:
        InputError: the two never touch; every contact is too deep.
    """
    touching, deep = found.touching, found.too_deep
    if not touching.any():
        gaps = np.nanmax(found.depth, axis=1, initial=-np.inf)
        how = "farther apart than was looked" if not np.isfinite(gaps).any() else f"{-1e3 * gaps.max():.3g} mm apart"
        raise InputError(
            f"the two never touch in {touching.size} frames: at their nearest they are {how}",
            where=poses.source,
            remedy="check the poses' accuracy: a tenth of a millimetre is much of a contact",
        )
    if deep.any():
        first = int(np.flatnonzero(deep)[0])
        words = (
            f"{deep.sum()} of {deep.size} frames are deeper than {1e3 * DEEPEST:g} mm, "
            f"the first at {poses.times[first]:g} s by {1e3 * found.largest_depth[first]:.3g} mm"
        )
        if deep[touching].all():
            remedy = "check the poses' frames and units"
            raise InputError(words, where=poses.source, expected="fractions of a millimetre", remedy=remedy)
        warnings.warn(f"{poses.source}: {words}: flagged in the status", PftwinWarning, stacklevel=2)


def status(found: ContactMap) -> NDArray[np.int32]:
    """(n,) 1 where nothing touches, 2 where it is too deep; 0: no reservation."""
    return np.where(found.touching, 0, 1).astype(np.int32) + np.where(found.too_deep, 2, 0).astype(np.int32)


def _look(femur: SurfaceMesh, button: SurfaceMesh, poses: PoseSeries, k: int) -> MutualPlace:
    """How they lie to each other in a frame."""
    return mutual_place(femur, button, poses.positions[k], poses.matrices()[k])
