"""Loads a scene from a scene file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from jax.dtypes import canonicalize_dtype
from pydantic import Field, create_model

from pftwin.base.errors import InputError
from pftwin.base.program_cache import cached
from pftwin.files.scene_file.bones import BonePoses
from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.effect_tables import EffectSection, Setting
from pftwin.files.scene_file.measured_table import MeasuredSection
from pftwin.files.scene_file.mesh_tables import DrawnBonesSection
from pftwin.files.scene_file.problems import validated
from pftwin.files.scene_file.recording import SegmentRecording
from pftwin.files.scene_file.registry import effect_tables
from pftwin.files.scene_file.section import ONE_OR_MANY, FileName, Section
from pftwin.files.scene_file.segments import FemurSection, MotionSection, PatellaSection, PoseSection, TibiaSection
from pftwin.files.scene_file.side import AxesSection, Side
from pftwin.model.limits import Limits
from pftwin.model.scene import Scene, check

if TYPE_CHECKING:
    from pftwin.geometry.patch.sphere import SphereFit
    from pftwin.model.measured import Measured

SCHEMA = 1


class SceneSection(Section):
    """The whole file, without the effects."""

    schema_version: Literal[1] = Field(alias="schema", description="version of this format: schema = 1")
    name: FileName | None = Field(default=None, description="name of the scene; by default the file's name")
    side: Literal["right", "left"] = Field(
        default="right", description="side of the knee; a left knee is mirrored on input"
    )
    axes: AxesSection = Field(
        default_factory=AxesSection, description="table: the axes of each frame that are proximal, lateral, anterior"
    )
    patella: PatellaSection = Field(description="table: the patella")
    motion: MotionSection = Field(default_factory=MotionSection, description="table: the recording")
    femur: FemurSection = Field(
        default_factory=lambda: FemurSection(fixed=PoseSection()), description="table: pose or motion of the femur"
    )
    tibia: TibiaSection = Field(description="table: motion of the tibia")
    limits: dict[str, float] = Field(
        default_factory=dict, description="table: plausibility limits of a knee, set by name, such as most_mass_kg = 5"
    )
    measured: MeasuredSection | None = Field(
        default=None, description="table: measurements to compare the simulation with"
    )
    bones: DrawnBonesSection | None = Field(
        default=None, description="table: surfaces of bones for drawings; schematic by default"
    )


def scene_file_model() -> type[SceneSection]:
    """Model of the whole file, with the tables of all registered effects."""
    return _model(effect_tables())


@lru_cache(maxsize=8)
def _model(tables: tuple[type[EffectSection], ...]) -> type[SceneSection]:
    fields: Any = {
        table.kind: (
            Annotated[list[table], ONE_OR_MANY],
            Field(default_factory=list, description=f"table, or several: {(table.__doc__ or '').splitlines()[0]}"),
        )
        for table in tables
    }
    return create_model("SceneFile", __base__=SceneSection, **fields)


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene, with notes on how its recording and meshes were processed."""

    scene: Scene
    button: SphereFit | None  # sphere, if fitted to a mesh, of the contact whose centre is tracked; patella frame
    notes: tuple[str, ...]
    path: Path
    side_as_given: str = ""  # note that the files do not determine the side of the knee, if so; also in `notes`

    @property
    def measured(self) -> Measured | None:
        """The scene's measurements; None if the file has none."""
        return self.scene.measured


def load_scene(
    path: str | os.PathLike[str],
    *,
    contact: str | None = None,
    allow_outside: bool = False,
    limits: Mapping[str, float] | None = None,
    motion: str | os.PathLike[str] | None = None,
    rate: float | None = None,
) -> Scene:
    """Loads the scene that a TOML file describes.

    The scene's effects have the order of the tables in the file; tables of one kind follow the first of them.

    Args:
        path: the scene file; paths in it are relative to its folder.
        contact: polynomial for surfaces that are fitted to a mesh ("P2", "P4", "P5"), instead of the file's.
        allow_outside: whether the file may refer to files outside its folder; only for files from trusted sources.
        limits: plausibility limits of a knee (`pftwin.model.limits.Limits`), by name, instead of the file's.
        motion: another recording of the same knee, with the same names of bodies or markers, instead of the file's;
            forces, weights and time limits, which belong to the file's recording, are omitted.
        rate: frames per second of `motion`, if its times are frame numbers.

    Raises:
        InputError: an unreadable file, unknown or missing fields, invalid values: one message lists all problems with
            line and field. Another recording if the file has tensions over time.
    """
    options = {"allow_outside": allow_outside, "limits": limits, "motion": motion, "rate": rate}
    return load_scene_file(path, contact=contact, **options).scene


def load_scene_file(
    path: str | os.PathLike[str],
    *,
    contact: str | None = None,
    allow_outside: bool = False,
    limits: Mapping[str, float] | None = None,
    motion: str | os.PathLike[str] | None = None,
    rate: float | None = None,
) -> LoadedScene:
    """Like `load_scene`, but also returns the measurements, and notes for the user."""
    document = Document.read(path, allow_outside=allow_outside)
    if motion is not None:
        document = document.with_motion(motion, rate)
    kinds, float_type = [table.kind for table in effect_tables()], str(canonicalize_dtype(float))
    return cached(_loaded, document, contact, dict(limits or {}), kinds, float_type, files=document.files())


def _loaded(
    document: Document, contact: str | None, own_limits: dict[str, float], kinds: list[str], float_type: str
) -> LoadedScene:
    """The loaded scene, cached by its arguments: `kinds` are the tables' names, `float_type` JAX's default type."""
    _check_version(document)
    model: Any = scene_file_model()
    file, document = validated(document, model)
    side = Side.read(file.side == "left", file.axes, document)
    with document.naming("limits"):
        limits = Limits.of({**file.limits, **own_limits})
    notes: list[str] = []
    segments = SegmentRecording(file.motion, {"femur": file.femur, "tibia": file.tibia}, document, notes, limits)
    bones = BonePoses.read(segments, side, file.patella.start)
    start, beside_femur = bones.start_pose(file.patella.start)
    setting = Setting(bones, file.patella.mass_kg, beside_femur, contact, notes=notes)
    effects = tuple(  # in the file's order, which numbers K1, L1, K2, ...
        table.build(setting.at(kind, i))
        for kind in document.data
        if kind in kinds
        for i, table in enumerate(getattr(file, kind))
    )
    if not effects:
        raise InputError(
            "no effect acts on the patella", where=document.path, expected="[contact], [[tendon]], [gravity] ..."
        )
    name = file.name or document.path.stem
    scene = Scene(file.patella.body(side), effects, bones.motion, start.pose(), name, file.motion.synthetic)
    drawn = None if file.bones is None else file.bones.build(setting.at("bones"))
    scene = replace(scene, limits=limits, bones=drawn, left=side.left)
    with document.naming():
        check(scene)
    measured = None if file.measured is None else file.measured.build(scene, bones)
    segments.clusters.compare(document)
    unjudged = segments.clusters.side_as_given(file.side)
    notes += [unjudged] if unjudged else []
    button = None if scene.contact is None else setting.buttons.get(scene.contact.name)
    return LoadedScene(replace(scene, measured=measured), button, tuple(notes), document.path, unjudged)


def _check_version(document: Document) -> None:
    version = document.data.get("schema")
    if version != SCHEMA or isinstance(version, bool):
        raise InputError(
            "is missing" if version is None else f"found {version!r}",
            where=document.where("schema"),
            expected=f"schema = {SCHEMA}, the version of the format that this pftwin reads",
            remedy="a newer pftwin" if isinstance(version, int) and version > SCHEMA else None,
        )
