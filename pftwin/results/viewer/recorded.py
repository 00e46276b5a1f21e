"""Data of one result for the viewer, from memory or from its file: arrays at the shown frames, and contact arrows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.results.verdict import Verdict, verdict_of_file
from pftwin.results.viewer.shapes import FEW, Matrices, of_poses

if TYPE_CHECKING:
    from xarray import Dataset

FACETS = ("medial", "lateral")
MOST_FRAMES = 241  # largest number of frames shown; the viewer interpolates between them
Mesh = tuple[Floats, NDArray[np.int64]]  # vertices [m], triangles


@dataclass(frozen=True, eq=False)
class ContactArrow:
    """A contact, or the sum of several, at the n shown frames."""

    contact: str  # name of the effect
    name: str  # "contact, medial"
    points: Floats  # (n, 3) point of application [m]; NaN without load
    forces: Floats | None  # (n, 3) on the patella [N]; None if only the point is known
    touches: bool = True  # whether the surfaces touch at the points; False for a mean of several points

    @property
    def present(self) -> NDArray[np.bool_]:
        """Frames in which it carries load (n,)."""
        there = np.isfinite(self.points).all(axis=1)
        if self.forces is not None:
            there &= self.forces.any(axis=1)
        return np.asarray(there)


def contact_arrows(result: Recorded) -> list[ContactArrow]:
    """Returns the contact arrows of a result.

    The normal force on a sphere points towards its centre, so each facet has an arrow. For other contacts the file has
    only the magnitudes per facet: their arrow is the total force, at the mean point weighted by those magnitudes.
    """
    contacts = [str(n).removesuffix("_force_medial") for n in result.data.data_vars if str(n).endswith("_force_medial")]
    return [arrow for name in contacts for arrow in _of(result, name)]


def _of(result: Recorded, contact: str) -> list[ContactArrow]:
    words = contact.replace("_", " ")
    names = [f"{words}, {facet}" for facet in FACETS]
    points, sizes = ([result.series(f"{contact}_{kind}_{facet}") for facet in FACETS] for kind in ("point", "force"))
    facets = [(p, s) for p, s in zip(points, sizes, strict=True) if p is not None and s is not None]
    center = result.series("sphere_center")
    if len(facets) == len(FACETS) and center is not None and "button_radius" in result.geometry:
        directed = [_forces_toward(center, p, s) for p, s in facets]
        return [ContactArrow(contact, n, p, f) for n, (p, _), f in zip(names, facets, directed, strict=True)]
    components = [result.series(f"{contact}_force_{axis}") for axis in "xyz"]
    total = np.stack([c for c in components if c is not None], axis=-1)
    if total.shape[-1] != 3:
        return []
    pressed = result.series(f"{contact}_center_of_pressure")
    if pressed is not None:
        return [ContactArrow(contact, words, pressed, total)]
    if len(facets) < len(FACETS):
        return []
    borne = [np.where((s > 0)[:, None], p, np.nan) for p, s in facets]
    touching = [ContactArrow(contact, n, p, None) for n, p in zip(names, borne, strict=True)]
    return [*touching, ContactArrow(contact, words, _weighted_mean(facets), total, touches=False)]


def _forces_toward(center: Floats, points: Floats, sizes: Floats) -> Floats:
    """Forces (n, 3) with magnitudes `sizes` (n,) that point from the points towards the centre (n, 3)."""
    away = center - points
    return (sizes / np.linalg.norm(away, axis=1))[:, None] * away


def _weighted_mean(facets: list[tuple[Floats, Floats]]) -> Floats:
    """Mean of the points weighted by force magnitudes (n, 3); NaN where all are zero."""
    weights = np.stack([s for _, s in facets], axis=1)
    whole = weights.sum(axis=1, keepdims=True)
    shares = np.divide(weights, whole, out=np.full_like(weights, np.nan), where=whole > 0)
    places = np.stack([p for p, _ in facets], axis=1)
    return np.where(shares[..., None] == 0, 0.0, shares[..., None] * places).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A result at the n shown frames, and its drawable geometry."""

    name: str
    data: Dataset  # at the shown frames
    geometry: Dataset
    verdict: Verdict  # on the whole motion

    @classmethod
    def of(
        cls, source: Any, name: str | None = None, *, frames: int = MOST_FRAMES, geometry: Dataset | None = None
    ) -> Recorded:
        """Loads a `Result` or a result file.

        Args:
            source: the result, or the path of its file.
            name: name in the legend; by default that of the scene or file.
            frames: largest number of frames to show.
            geometry: the result's geometry, if already computed.

        Raises:
            InputError: no such file, not a result, a file without geometry, or fewer than two finite frames.
        """
        from pftwin.files.result_files import GEOMETRY, load_dataset, motion_dataset

        data = motion_dataset(source)
        if isinstance(source, str | os.PathLike):
            where = Path(source)
            drawn, label = load_dataset(source, group=GEOMETRY), where.stem
        else:
            where = label = source.scene_name
            drawn = source.geometry() if geometry is None else geometry
        return cls(name or label, data.isel(time=_shown(data, where, frames)), drawn, verdict_of_file(data))

    @property
    def times(self) -> Floats:
        """Times of the shown frames (n,) [s]."""
        return self.data["time"].values

    @cached_property
    def patella(self) -> Matrices:
        """Poses of the patella in the femur frame (n, 4, 4) [mm]."""
        return of_poses(self.data["patella_position"].values, self.data["patella_quaternion"].values)

    @cached_property
    def tibia(self) -> Matrices:
        """Poses of the tibia in the femur frame (n, 4, 4) [mm]."""
        return of_poses(self.data["tibia_position"].values, self.data["tibia_quaternion"].values)

    def placed(self, body: str, points: Floats) -> Floats:
        """Transforms points of a body, (k, 3) or moving (n, k, 3) [m], to the femur frame, (n, k, 3) [m]."""
        from scipy.spatial.transform import Rotation

        if f"{body}_quaternion" not in self.data:  # the femur
            return np.broadcast_to(points, (len(self.times), *points.shape[-2:]))
        turn = Rotation.from_quat(self.data[f"{body}_quaternion"].values, scalar_first=True).as_matrix()
        points = np.broadcast_to(points, (len(turn), *points.shape[-2:]))
        return np.einsum("nij,nkj->nki", turn, points) + self.data[f"{body}_position"].values[:, None]

    @property
    def note(self) -> str:
        """States that the data are synthetic; empty if they are not."""
        return str(self.data.attrs.get("note", ""))

    def mesh(self, name: str) -> Mesh | None:
        """Returns a mesh of the scene's geometry by name; None if there is none."""
        if f"{name}_vertices" not in self.geometry:
            return None
        vertices, triangles = (self.geometry[f"{name}_{part}"].values for part in ("vertices", "triangles"))
        return vertices.astype(np.float64), triangles.astype(np.int64)

    @cached_property
    def lines(self) -> dict[str, Lines]:
        """Lines of force, by effect."""
        names = [str(n).removesuffix("_origin") for n in self.geometry.data_vars if str(n).endswith("_origin")]
        return {n: Lines(self, n) for n in names}

    @cached_property
    def contact_arrows(self) -> list[ContactArrow]:
        """Contact points and forces."""
        return contact_arrows(self)

    def series(self, name: str) -> Floats | None:
        """Returns a variable at the shown frames; None if the result lacks it."""
        return np.asarray(self.data[name].values, dtype=np.float64) if name in self.data else None

    @cached_property
    def frames(self) -> NDArray[np.int64]:
        """Indices of the shown frames among all frames (n,)."""
        return self.data["frame"].values


@dataclass(frozen=True, eq=False)
class Lines:
    """The k lines of one tendon, ligament or muscle."""

    result: Recorded
    name: str

    @property
    def insertion(self) -> Floats:
        """Insertions on the patella, in the patella's frame (k, 3) [m]."""
        return self.result.geometry[f"{self.name}_insertion"].values

    @property
    def body(self) -> str:
        """The body at the other end: "femur", "tibia" or "ground"."""
        return str(self.result.geometry[f"{self.name}_origin"].attrs["body"])

    @property
    def origin(self) -> Floats:
        """Origins in the frame of that body (k, 3) [m], or (n, k, 3) at the shown frames if they move."""
        values = self.result.geometry[f"{self.name}_origin"]
        return values.values[self.result.frames] if "time" in values.dims else values.values

    @property
    def paths(self) -> Floats:
        """The lines from insertion to origin in the femur frame (n, k, m, 3) [m].

        m is 2, or larger for lines of which one runs over its obstacle at some frame. In straight ones the points
        between the ends are evenly spaced.
        """
        ends = [self.result.placed(*end)[:, :, None] for end in (("patella", self.insertion), (self.body, self.origin))]
        arc = self.result.geometry.get(f"{self.name}_arc")
        if arc is None:
            return np.concatenate(ends, axis=2)
        bent = arc.values[self.result.frames].astype(np.float64)
        count = bent.shape[2]
        bent = self.result.placed(str(arc.attrs["body"]), bent.reshape(len(bent), -1, 3)).reshape(bent.shape)
        share = np.linspace(0, 1, count + 2)[1:-1, None]
        straight = (1 - share) * ends[0] + share * ends[1]
        return np.concatenate([ends[0], np.where(np.isnan(bent), straight, bent), ends[1]], axis=2)

    @property
    def radius(self) -> float:
        """Radius of a drawn line [m]; thinner if there are many strands."""
        return 1.7e-3 if len(self.insertion) <= FEW else 0.55e-3


def _shown(data: Dataset, where: object, most: int) -> NDArray[np.int64]:
    """Selects evenly spaced frames with finite poses; stores all frame indices in the dataset as `frame`."""
    from pftwin.files.result_files import finite_frames

    finite = finite_frames(data)
    if finite.size < 2:
        raise InputError(f"{finite.size} frames with finite poses", where=where, expected="at least 2")
    chosen = finite[np.unique(np.round(np.linspace(0, finite.size - 1, min(most, finite.size))).astype(int))]
    data["frame"] = (("time",), np.arange(data.sizes["time"]))
    return chosen


def recorded(results: Any) -> list[Recorded]:
    """Loads one source, several, or several by name (a mapping or pairs); equal names get a number.

    Raises:
        InputError: no result, or as in `Recorded.of`.
    """
    if isinstance(results, Mapping):
        given: list[Any] = list(results.items())
    elif isinstance(results, list | tuple):
        given = list(results)
    else:
        given = [results]
    found = [Recorded.of(*reversed(g)) if isinstance(g, tuple) else Recorded.of(g) for g in given]
    if not found:
        raise InputError("nothing to draw", where="view", expected="at least one result")
    names = [r.name for r in found]
    return [
        r if names.count(r.name) == 1 else replace(r, name=f"{r.name} ({names[: i + 1].count(r.name)})")
        for i, r in enumerate(found)
    ]
