"""Contact of two meshes at given poses: forces, pressures, and depth and pressure on every triangle of the button."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from pftwin.base.spatial import Quaternion, Scalar, Vec3
from pftwin.files.mocap.poses import PoseSeries
from pftwin.geometry.contact.depth_sides import PressedSurface, PressingSurface
from pftwin.geometry.contact.depths import DEEPEST, Depths, depths
from pftwin.model.effects.foundation_law import FoundationLaw
from pftwin.studies.runs import run_each

BAND = 1e-3  # [m] how far from the femur a triangle's distance is still told

Floats = NDArray[np.float64]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class ContactMap:
    """Frame by frame; vectors along the femur's axes."""

    times: Floats  # (n,) [s]
    force: Floats  # (n, 3) on the patella [N]
    moment: Floats  # (n, 3) about the origin of the patella's frame [N m]
    area: Floats  # (n,) in contact [m^2]
    mean_pressure: Floats  # (n,) over that area [Pa]
    max_pressure: Floats  # (n,) [Pa]
    center_of_pressure: Floats  # (n, 3) in the femur's frame, NaN where nothing touches [m]
    center_on_patella: Floats  # (n, 3) the same point in the patella's frame [m]
    largest_depth: Floats  # (n,) of a centroid [m]
    depth: NDArray[np.float32]  # (n, triangles) of the button [m]; NaN farther outside than the band
    pressure: NDArray[np.float32]  # (n, triangles) [Pa]

    @property
    def touching(self) -> NDArray[np.bool_]:
        """(n,) whether a triangle is in contact."""
        return self.area > 0

    @property
    def too_deep(self) -> NDArray[np.bool_]:
        """(n,) whether a triangle is deeper than any joint bears: no contact of these two parts is meant."""
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
    """The contact at every pose, frame by frame: memory does not grow with the recording but for the result.

    Args:
        femur, button: in the frames whose poses are given.
        law: pressure over depth.
        poses: of the button's frame in the femur's.
        triangles: of the button's mesh.
        band: how far outside triangles are still told how far [m].
        progress: told after each frame how many frames are done, and of how many.

    Returns:
        The map. After an interrupt (Ctrl-C) it ends with the last frame that was done.

    Raises:
        KeyboardInterrupt: interrupted before the first frame was done.
    """

    @jax.jit
    def look(femur: PressedSurface, button: PressingSurface, law: FoundationLaw, at: tuple[Array, Array]) -> dict:
        return _frame(femur, button, law, *at, band)

    def one(k: int) -> dict[str, np.ndarray]:
        at = tuple(jnp.asarray(a[k], dtype=float) for a in (poses.positions, poses.quaternions))
        frame = jax.device_get(look(femur, button, law, at))
        for key, otherwise in (("depths", np.nan), ("pressures", 0.0)):
            frame[key] = _spread(frame, key, triangles, otherwise)
        return {key: value for key, value in frame.items() if key not in ("listed", "triangle")}

    n = poses.times.size
    frames = run_each(range(n), one, after=lambda answers: progress(len(answers), n))
    done = len(frames)
    found = {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}
    center = found["center_of_pressure"]
    back = np.einsum("nji,nj->ni", poses.matrices()[:done], center - poses.positions[:done])
    return ContactMap(
        times=poses.times[:done],
        force=found["force"],
        moment=found["moment"],
        area=found["area"],
        mean_pressure=found["mean_pressure"],
        max_pressure=found["max_pressure"],
        center_of_pressure=center,
        center_on_patella=back,
        largest_depth=found["depth"],
        depth=found["depths"],
        pressure=found["pressures"],
    )


def _frame(
    femur: PressedSurface,
    button: PressingSurface,
    law: FoundationLaw,
    position: Array,
    quaternion: Array,
    band: float,
) -> dict[str, Array]:
    """One frame; the list has room for every triangle, so nothing is lost."""
    at = Vec3.from_array(position)
    found = depths(button, femur, at, Quaternion.from_array(quaternion).rotation(), band=band)
    answer = law.press(jnp.where(found.listed, found.depth, -1.0))
    push = (found.area * answer.pressure) * found.normal
    arm = found.point - Vec3(*(jnp.broadcast_to(a, found.depth.shape) for a in (at.x, at.y, at.z)))
    return {
        **_summary(found, answer.pressure),
        "force": push.sum().array(),
        "moment": arm.cross(push).sum().array(),
        "listed": found.listed,
        "triangle": found.triangle,
        "depths": found.depth,
        "pressures": answer.pressure,
    }


def _summary(found: Depths, pressure: Scalar) -> dict[str, Scalar]:
    """Area, pressures, centre of pressure (femur frame), and depth of a contact."""
    touching = found.listed & (found.depth > 0)
    area = jnp.sum(jnp.where(touching, found.area, 0.0))
    borne = jnp.where(touching, found.area * pressure, 0.0)
    total = jnp.sum(borne)
    some = total > 0
    deepest = jnp.max(jnp.where(touching, found.depth, 0.0))
    center = (1 / jnp.where(some, total, 1.0)) * (borne * found.point).sum()
    return {
        "area": area,
        "mean_pressure": jnp.where(some, total / jnp.where(some, area, 1.0), 0.0),
        "max_pressure": jnp.max(jnp.where(touching, pressure, 0.0)),
        "center_of_pressure": jnp.where(some, center.array(), jnp.nan),
        "depth": deepest,
    }


def _spread(frame: dict[str, np.ndarray], key: str, triangles: int, otherwise: float) -> NDArray[np.float32]:
    """Values of the list on the whole mesh, (triangles,) in single precision."""
    listed = frame["listed"]
    whole = np.full(triangles, otherwise, dtype=np.float32)
    whole[frame["triangle"][listed]] = frame[key][listed]
    return whole
