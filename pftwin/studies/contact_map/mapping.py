"""Contact of two meshes at given poses: forces, pressures, and depth and pressure on every triangle of the button.

Checks report meshes, poses and results that are not consistent with each other.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.spatial import Quaternion, Scalar, Vec3
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.contact.behind import mutual_place
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface
from pftwin.geometry.contact.depths import DEEPEST, Depths, depths
from pftwin.geometry.mesh.mesh import PLAUSIBLE, UNITS, SurfaceMesh, load_mesh, plausible_units
from pftwin.model.effects.foundation_law import FoundationLaw
from pftwin.studies.runs import run_each

BAND = 1e-3  # largest distance outside the femur at which depths are computed [m]

_FRAME, _VECTOR, _MAP = ("time",), ("time", "axis"), ("time", "triangle")  # dimensions of arrays
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class ContactMap:
    """Contact at n frames, with dimensions, unit and long name of each array; vectors are along the femur's axes."""

    times: Floats  # (n,) [s]
    force: Annotated[Floats, _VECTOR, "N", "contact force on the patella"]
    moment: Annotated[Floats, _VECTOR, "N m", "its moment about the origin of the patella's frame"]
    area: Annotated[Floats, _FRAME, "m^2", "contact area"]
    mean_pressure: Annotated[Floats, _FRAME, "Pa", "mean pressure over the contact area"]
    max_pressure: Annotated[Floats, _FRAME, "Pa", "maximum pressure"]
    center_of_pressure: Annotated[Floats, _VECTOR, "m", "centre of pressure, femur frame"]  # NaN without contact
    center_on_patella: Annotated[Floats, _VECTOR, "m", "centre of pressure, patella frame"]
    largest_depth: Annotated[Floats, _FRAME, "m", "depth of the deepest triangle"]
    depth: Annotated[NDArray[np.float32], _MAP, "m", "depth below the femur's surface; missing: farther off"]
    pressure: Annotated[NDArray[np.float32], _MAP, "Pa", "pressure on the triangle"]

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Whether any triangle is in contact (n,)."""
        return self.area > 0

    @property
    def too_deep(self) -> NDArray[np.bool_]:
        """Whether any triangle is deeper than plausible in a joint, a sign of inconsistent input (n,)."""
        return self.largest_depth > DEEPEST


def map_contact(
    femur: PressedSurface,
    button: PressingSurface,
    law: FoundationLaw,
    poses: PoseSeries,
    *,
    triangles: int,
    band: float = BAND,
    progress: Progress = lambda done, of: None,
) -> ContactMap:
    """Computes the contact at every pose, frame by frame; only the result's memory grows with the recording.

    Args:
        femur, button: surfaces in the frames to which the poses refer.
        law: pressure as a function of depth.
        poses: poses of the button's frame in the femur's.
        triangles: number of triangles of the button's mesh.
        band: largest distance outside the femur at which depths are computed [m].
        progress: called after each frame with the number of frames done and their total.

    Returns:
        The map. After an interrupt (Ctrl-C) it ends with the last finished frame.

    Raises:
        KeyboardInterrupt: interrupted before the first frame was done.
    """

    look = jax.jit(partial(_frame, band=band))

    def one(k: int) -> dict[str, np.ndarray]:
        at = (jnp.asarray(a[k], dtype=float) for a in (poses.positions, poses.quaternions))
        frame = jax.device_get(look(femur, button, law, *at))
        for key, otherwise in (("depth", np.nan), ("pressure", 0.0)):
            frame[key] = _on_whole_mesh(frame, key, triangles, otherwise)
        return {key: value for key, value in frame.items() if key not in ("listed", "triangle")}

    n = poses.times.size
    frames = run_each(range(n), one, after=lambda answers: progress(len(answers), n))
    done = len(frames)
    found = {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}
    center = found["center_of_pressure"]
    back = np.einsum("nji,nj->ni", poses.matrices()[:done], center - poses.positions[:done])
    return ContactMap(times=poses.times[:done], center_on_patella=back, **found)


def _frame(
    femur: PressedSurface, button: PressingSurface, law: FoundationLaw, position: Array, quaternion: Array, band: float
) -> dict[str, Array]:
    """The contact of one frame; the list has room for every triangle, so none is lost."""
    at = Vec3.from_array(position)
    found = depths(button, femur, at, Quaternion.from_array(quaternion).rotation(), band=band)
    answer = law.press(jnp.where(found.listed, found.depth, -1.0))
    forces = (found.area * answer.pressure) * found.normal
    arm = found.point - Vec3(*(jnp.broadcast_to(a, found.depth.shape) for a in (at.x, at.y, at.z)))
    return {
        **_summary(found, answer.pressure),
        "force": forces.sum().array(),
        "moment": arm.cross(forces).sum().array(),
        "listed": found.listed,
        "triangle": found.triangle,
        "depth": found.depth,
        "pressure": answer.pressure,
    }


def _summary(found: Depths, pressure: Scalar) -> dict[str, Scalar]:
    """Area, pressures, centre of pressure (femur frame) and largest depth of a contact."""
    touching = found.listed & (found.depth > 0)
    area = jnp.sum(jnp.where(touching, found.area, 0.0))
    borne = jnp.where(touching, found.area * pressure, 0.0)
    total = jnp.sum(borne)
    some = total > 0
    center = (1 / jnp.where(some, total, 1.0)) * (borne * found.point).sum()
    return {
        "area": area,
        "mean_pressure": jnp.where(some, total / jnp.where(some, area, 1.0), 0.0),
        "max_pressure": jnp.max(jnp.where(touching, pressure, 0.0)),
        "center_of_pressure": jnp.where(some, center.array(), jnp.nan),
        "largest_depth": jnp.max(jnp.where(touching, found.depth, 0.0)),
    }


def _on_whole_mesh(frame: dict[str, np.ndarray], key: str, triangles: int, otherwise: float) -> NDArray[np.float32]:
    """Expands values of the listed triangles to the whole mesh, (triangles,) in single precision."""
    listed = frame["listed"]
    whole = np.full(triangles, otherwise, dtype=np.float32)
    whole[frame["triangle"][listed]] = frame[key][listed]
    return whole


_LOOKS = 5  # number of frames to check before computing


def load_pair(
    femur: str | os.PathLike[str], patella: str | os.PathLike[str], *, units: str, patella_units: str | None = None
) -> tuple[SurfaceMesh, SurfaceMesh]:
    """Loads both meshes in metres; InputError as in `load_mesh`, and for a size that does not fit the units."""
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
    """Checks in a few frames of the recording that the button is neither inside the femur nor far from it.

    Raises InputError if in all these frames more than half of the button is behind the surface, or it is far away.
    """
    frames = np.unique(np.linspace(0, poses.times.size - 1, _LOOKS).round().astype(int))
    matrices = poses.matrices()
    looks = [mutual_place(femur, button, poses.positions[k], matrices[k]) for k in frames]
    if all(look.behind > 0.5 for look in looks):
        raise InputError(
            f"at {poses.times[frames[0]]:g} s {looks[0].behind:.0%} of the button are inside the femur, "
            "and it is no better at the other times that were checked",
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
    """Raises InputError if nothing touches or every contact is too deep; warns if only some frames are too deep."""
    touching, deep = found.touching, found.too_deep
    if not touching.any():
        gaps = np.nanmax(found.depth, axis=1, initial=-np.inf)
        how = "farther apart than the band" if not np.isfinite(gaps).any() else f"{-1e3 * gaps.max():.3g} mm apart"
        raise InputError(
            f"the two surfaces never touch in {touching.size} frames: at their nearest they are {how}",
            where=poses.source,
            remedy="check the poses' accuracy: a tenth of a millimetre is much of a contact",
        )
    if deep.any():
        first = int(np.argmax(deep))
        words = (
            f"{deep.sum()} of {deep.size} frames are deeper than {1e3 * DEEPEST:g} mm, "
            f"the first at {poses.times[first]:g} s by {1e3 * found.largest_depth[first]:.3g} mm"
        )
        if deep[touching].all():
            remedy = "check the poses' frames and units"
            raise InputError(words, where=poses.source, expected="fractions of a millimetre", remedy=remedy)
        warnings.warn(f"{poses.source}: {words}: flagged in the status", PftwinWarning, stacklevel=2)


def status(found: ContactMap) -> NDArray[np.int32]:
    """Returns the status of each frame (n,): 1 without contact, 2 if too deep, otherwise 0."""
    return (~found.touching + 2 * found.too_deep).astype(np.int32)
