"""What is drawn of one result, from memory or from its file: arrays at the frames shown, contacts as arrows."""

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
from pftwin.results.viewer.shapes import Matrices, of_poses

if TYPE_CHECKING:
    from xarray import Dataset

FACETS = ("medial", "lateral")
FEW = 4  # lines of an effect that are drawn as thick as a tendon
MOST_FRAMES = 241  # shown of a result; between them a drawing interpolates
Mesh = tuple[Floats, NDArray[np.int64]]  # vertices [m], triangles


@dataclass(frozen=True, eq=False)
class ContactArrow:
    """A contact, or the sum of several, at the frames shown (n)."""

    contact: str  # the effect
    name: str  # "contact, medial"
    points: Floats  # (n, 3) where it acts [m]; NaN where it bears nothing
    forces: Floats | None  # (n, 3) on the patella [N]; None where only the point is known
    touches: bool = True  # whether the points are such where surfaces touch, and not a middle of several

    @property
    def present(self) -> NDArray[np.bool_]:
        """Frames in which it bears a load (n,)."""
        there = np.isfinite(self.points).all(axis=1)
        if self.forces is not None:
            there &= self.forces.any(axis=1)
        return np.asarray(there)


def contact_arrows(result: Recorded) -> list[ContactArrow]:
    """The contacts of a result.

    A sphere is pushed towards its centre, so the (normal) force on each facet has a direction. Of other contacts the
    file holds the facets' sizes alone: their force is the sum, at the points' middle weighted by the sizes.
    """
    contacts = [str(n).removesuffix("_force_medial") for n in result.data.data_vars if str(n).endswith("_force_medial")]
    return [push for name in contacts for push in _of(result, name)]


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
    """Forces (n, 3) of sizes (n,) from points towards the centre (n, 3)."""
    away = center - points
    return (sizes / np.linalg.norm(away, axis=1))[:, None] * away


def _weighted_mean(facets: list[tuple[Floats, Floats]]) -> Floats:
    """Mean of the points weighted by sizes (n, 3); NaN where all sizes are zero."""
    weights = np.stack([s for _, s in facets], axis=1)
    whole = weights.sum(axis=1, keepdims=True)
    shares = np.divide(weights, whole, out=np.full_like(weights, np.nan), where=whole > 0)
    places = np.stack([p for p, _ in facets], axis=1)
    return np.where(shares[..., None] == 0, 0.0, shares[..., None] * places).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A result's numbers at the frames that are shown (n), and what there is to draw."""

    name: str
    data: Dataset  # of the frames shown
    geometry: Dataset
    verdict: Verdict  # on the whole motion

    @classmethod
    def of(
        cls, source: Any, name: str | None = None, *, frames: int = MOST_FRAMES, geometry: Dataset | None = None
    ) -> Recorded:
        """From a `Result`, or from the file of one.

        Args:
            source: the result, or a path.
            name: in the legend; None: the scene's, or the file's.
            frames: most that are shown.
            geometry: of a result, where that is known already.

        Raises:
            InputError: no such file, not a result, a file without anything to draw, or no frame that is finite.
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
        """Times of the frames shown (n,) [s]."""
        return self.data["time"].values

    @cached_property
    def patella(self) -> Matrices:
        """The patella in the femur (n, 4, 4) [mm]."""
        return of_poses(self.data["patella_position"].values, self.data["patella_quaternion"].values)

    @cached_property
    def tibia(self) -> Matrices:
        """The tibia in the femur (n, 4, 4) [mm]."""
        return of_poses(self.data["tibia_position"].values, self.data["tibia_quaternion"].values)

    def placed(self, body: str, points: Floats) -> Floats:
        """Points (k, 3), or (n, k, 3) that move, of a body's frame in the femur's, (n, k, 3) [m]."""
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_quat(self.data[f"{body}_quaternion"].values, scalar_first=True).as_matrix()
        points = np.broadcast_to(points, (len(turn), *points.shape[-2:]))
        return np.einsum("nij,nkj->nki", turn, points) + self.data[f"{body}_position"].values[:, None]

    @property
    def note(self) -> str:
        """Says that the data are synthetic; empty where they are not."""
        return str(self.data.attrs.get("note", ""))

    def mesh(self, name: str) -> Mesh | None:
        """A mesh of the scene's geometry; None where it has none of that name."""
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
        """A variable at the frames shown; None where the result has none of that name."""
        return np.asarray(self.data[name].values, dtype=np.float64) if name in self.data else None

    @cached_property
    def frames(self) -> NDArray[np.int64]:
        """Places of the frames shown among all frames (n,)."""
        return self.data["frame"].values


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of one tendon, ligament or muscle (k)."""

    result: Recorded
    name: str

    @property
    def insertion(self) -> Floats:
        """Insertions on the patella, in its frame (k, 3) [m]."""
        return self.result.geometry[f"{self.name}_insertion"].values

    @property
    def body(self) -> str:
        """The body at the other end: "femur", "tibia" or "ground"."""
        return str(self.result.geometry[f"{self.name}_origin"].attrs["body"])

    @property
    def origin(self) -> Floats:
        """Origins on that body, in its frame (k, 3), or (n, k, 3) at the frames shown where it moves [m]."""
        values = self.result.geometry[f"{self.name}_origin"]
        return values.values[self.result.frames] if "time" in values.dims else values.values

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """Insertions and origins in the femur's frame (n, k, 3) each [m]."""
        insertion = self.result.placed("patella", self.insertion)
        origin = self.result.placed("tibia", self.origin) if self.body == "tibia" else self.origin
        return insertion, np.broadcast_to(origin, insertion.shape)

    @property
    def radius(self) -> float:
        """Radius of a drawn line [m]: one of many strands is thin."""
        return 1.7e-3 if len(self.insertion) <= FEW else 0.55e-3


def _shown(data: Dataset, where: object, most: int) -> NDArray[np.int64]:
    """Frames evenly spread over those with finite poses; notes their places in the dataset as `frame`."""
    from pftwin.files.result_files import finite_frames

    finite = finite_frames(data)
    if finite.size < 2:
        raise InputError(f"{finite.size} frames with finite poses", where=where, expected="at least 2")
    chosen = finite[np.unique(np.round(np.linspace(0, finite.size - 1, min(most, finite.size))).astype(int))]
    data["frame"] = (("time",), np.arange(data.sizes["time"]))
    return chosen


def recorded(results: Any) -> list[Recorded]:
    """The numbers of one source, of several, or of several by name (a mapping, or pairs); names are made different.

    Raises:
        InputError: no result, or what `Recorded.of` refuses.
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
