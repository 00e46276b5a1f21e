"""An OpenSim model as a scene folder: scene.toml, poses.csv, meshes, and a list of what was left out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.errors import InputError, OutputError
from pftwin.base.text_files import write_text
from pftwin.files.interchange import osim_motion
from pftwin.files.interchange.osim_document import Element, read_osim
from pftwin.files.interchange.osim_knee import FOLDER, PARTS, OsimKnee, Written, bones, find_knee, load_mesh
from pftwin.files.interchange.osim_lines import PatellarMuscle, ligament_lines, pulls
from pftwin.files.interchange.osim_model import CONTACT, LIGAMENT, SURFACE, LeftOut, OsimContact, read_model
from pftwin.files.interchange.osim_toml import poses_csv, report, scene_text
from pftwin.files.interchange.osim_wraps import Wraps
from pftwin.model.limits import Limits

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_clusters import Recording

REPORT = "not_imported.md"
RECORDING = "markers.trc"
MARKER_FILES = (".trc", ".c3d", ".csv")
_SETS = {
    "ControllerSet": "a scene has no controllers",
    "ProbeSet": "results report what effects do by themselves",
    "MarkerSet": "markers serve where the motion is a recording of them",
    "ConstraintSet": "the bones' motion is prescribed",
}
_READ = (LIGAMENT, CONTACT, "CoordinateCouplerConstraint")


@dataclass
class Imported:
    """What was written, what was assumed, and what was left out."""

    files: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    muscles: list[PatellarMuscle] = field(default_factory=list)  # of the patella
    # Of those that were taken over, by name, in the first frame [N].
    tensions: dict[str, float] = field(default_factory=dict)

    @property
    def scene(self) -> Path:
        """The scene file."""
        return self.files[0]


def import_osim(
    model: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    motion: str | os.PathLike[str] | None = None,
    rate: float | None = None,
    bend: str | None = None,
    quadriceps: float | None = None,
    activation: float | str | os.PathLike[str] | None = None,
    side: str | None = None,
    femur: str | None = None,
    tibia: str | None = None,
    patella: str | None = None,
    geometry: Sequence[str | os.PathLike[str]] = (),
    markers: str | os.PathLike[str] | None = None,
    units: str | None = None,
    without: Sequence[str] = (),
    joint_centers: bool = False,
    limits: Mapping[str, float] | None = None,
) -> Imported:
    """Writes a scene of a model's knee: the patella, its ligaments and its contact; how the bones move.

    Imported are bodies with their mass and meshes, `Blankevoort1991Ligament` of two points, `Smith2018ContactMesh` with
    the `Smith2018ArticularContactForce` between femur and patella, joints and coordinates (for the motion and the
    patella's start), `WrapCylinder` and `WrapEllipsoid`. What is not, is listed with the reason.

    Args:
        model: .osim file of OpenSim 4.
        folder: of the scene; made if it is not there.
        motion: .mot or .sto file of coordinates, or .sto file of the bodies' poses as matrices (BODY_T11 ... BODY_T44);
            where the patella is among them, its poses are the scene's measurements. TRC, C3D or CSV file of the
            markers of femur and tibia, and maybe of the patella. None: the knee is bent through its range.
        rate: frames per second, where the times of a file of poses count frames.
        bend: the coordinate to bend by, where there is no motion; None: the first rotation of the tibia's joint.
        quadriceps: a constant tension [N] of all muscles together that end on the patella, shared out by their maximum
            isometric forces, from the point before on their paths; None: they are left out.
        activation: in place of a tension, the activation of these muscles, 0 to 1, or a STO, MOT or CSV file of
            activations over time, in columns called like the muscles or by their paths. Their tensions follow from it
            and from the lengths of their paths, at rest.
        side: "right" or "left"; None: as the patella's name ends.
        femur, tibia, patella: names of bodies, where they cannot be told.
        geometry: folders with meshes, besides the model's own and `Geometry` in it.
        markers: file of the <MarkerSet> that a recording of markers goes by; None: the model's own.
        units: of a recording of markers that has none.
        without: markers to leave out, by the recording's or the model's names.
        joint_centers: whether the centres of hip (by the pelvis' markers) and knee (by the tibia's) count as markers of
            the femur, for want of good ones.
        limits: of what a knee can be (`pftwin.model.limits.Limits`), by name, for the scene to have.

    Raises:
        InputError: no model of OpenSim 4, or one without such a knee; joints, functions or numbers that cannot be read;
            contact meshes that are not there; a tension or an activation, and no muscle to have it; both of them.
        OutputError: the folder cannot be written to, or holds one of these files already.
    """
    from pftwin.files.interchange.osim_activation import FILE
    from pftwin.files.mocap.trc import trc_text

    if quadriceps is not None and activation is not None:
        raise InputError("both a tension and an activation", where="activation", expected="one of them")
    Limits.of(limits or {})
    found = read_model(read_osim(model))
    knee = find_knee(found, side, femur=femur, tibia=tibia, patella=patella)
    told = Imported(left_out=list(found.left_out))
    places = [Path(p) for p in geometry]
    seen = moved = None
    how: dict[str, Any] = {"units": units, "without": tuple(without), "joint_centers": joint_centers}
    if motion is not None:
        _refuse_others("a motion", bend=bend)
    if motion is not None and Path(motion).suffix.lower() in MARKER_FILES:
        _refuse_others("a recording of markers", rate=rate)
        if activation is not None:
            expected = "coordinates (.mot) or poses (.sto), by which muscles have lengths; or a constant tension"
            raise InputError("an activation, and a recording of markers", where="activation", expected=expected)
        seen = _recording(knee, motion, markers, told, how)
    else:
        _refuse_others("no recording of markers as motion", markers=markers, **how)
        moved = osim_motion.motion_of(knee, motion, rate, bend)
        told.notes.append(f"motion: {moved.said}")
    if found.bodies[knee.patella].mass <= 0:
        raise InputError("a patella without mass", where=found.bodies[knee.patella].where, expected="a positive mass")
    wraps = Wraps(knee)
    strands = ligament_lines(knee, wraps, told)
    contact, pressing = _contact_meshes(knee, places, told)
    drawn = list(bones(knee, places, {m.file for m in pressing}, told.left_out))
    if drawn:
        told.notes.append(f"bones: {len(drawn)} meshes lie in {FOLDER}/; a scene file has no table for them")
    pulling, pulled = pulls(knee, moved, told, quadriceps, activation, wraps)
    told.left_out += _unused_elements(found.root, told, recorded=seen is not None)
    if any(wrap is not None and wrap.kind == "cylinder" for _, wrap in (*strands, *pulling)):
        told.notes.append("wrapping: cylinders are taken as endless")
    text = scene_text(knee, strands, contact, pressing, told, moved, pulling, pulled, seen, limits or {})
    tables = {} if moved is None else {"poses.csv": poses_csv(moved)}
    tables |= {} if seen is None else {RECORDING: trc_text(RECORDING, seen.markers)}
    if moved is not None and pulled is not None:
        tables[FILE] = pulled.table(moved.times)
    _write(Path(folder), text, tables, [*pressing, *drawn], told)
    return told


def _recording(
    knee: OsimKnee,
    motion: str | os.PathLike[str],
    markers: str | os.PathLike[str] | None,
    told: Imported,
    how: dict[str, Any],
) -> Recording:
    """The markers of the knee, and their recording."""
    from pftwin.files.interchange.osim_clusters import read_recording
    from pftwin.files.interchange.osim_markers import markers_of

    known = markers_of(knee, markers, told.left_out)
    seen = read_recording(motion, knee, known, **how)
    why = "it is not in the recording, or not seen throughout, or was left out"
    told.left_out += [
        LeftOut("Marker", m.name, why if m.part in PARTS else "it is on no bone of the knee")
        for m in known
        if m.name not in seen.used
    ]
    told.notes += [f"motion: markers of {os.fspath(motion)}; {osim_motion.GROUND_AS_MODEL}", *seen.notes]
    return seen


def _refuse_others(found: str, **options: Any) -> None:
    """Refuses options that have no meaning for a motion."""
    given = [name for name, value in options.items() if value is not None and value is not False and value != ()]
    if given:
        raise InputError(f"{given[0]} given, and {found}", where=given[0], expected="one or the other")


def _contact(knee: OsimKnee, told: Imported) -> OsimContact | None:
    """The contact of femur and patella, the femur's surface first."""
    chosen, surfaces = None, knee.model.surfaces
    for contact in knee.model.contacts:
        missing = [s for s in contact.surfaces if s not in surfaces]
        parts = [] if missing else [knee.placed(surfaces[s].mesh.frame)[0] for s in contact.surfaces]
        if missing:
            why = f"there is no contact mesh {missing[0]!r}"
        elif sorted(parts) != ["femur", "patella"]:
            why = f"it is between {' and '.join(parts)}, whose motion is prescribed"
        elif chosen is not None:
            why = "a scene has one contact"
        else:
            chosen = contact if parts[0] == "femur" else contact._replace(surfaces=contact.surfaces[::-1])
            continue
        told.left_out.append(LeftOut(CONTACT, contact.name, why))
    return chosen


def _contact_meshes(knee: OsimKnee, places: list[Path], told: Imported) -> tuple[OsimContact | None, list[Written]]:
    """The contact with its two meshes; neither where a mesh cannot be read."""
    contact = _contact(knee, told)
    if contact is None:
        return None, []
    try:
        return contact, [load_mesh(knee.model.surfaces[s].mesh, knee, places) for s in contact.surfaces]
    except InputError as error:
        told.left_out.append(LeftOut(CONTACT, contact.name, str(error)))
        return None, []


def _write(folder: Path, text: str, tables: dict[str, str], meshes: list[Written], told: Imported) -> None:
    """All files, or none where one of them is there already."""
    from pftwin.geometry.mesh.mesh import save_mesh

    names = ["scene.toml", *tables, REPORT, *(m.file for m in meshes)]
    for name in names:
        if (folder / name).exists():
            raise OutputError(f"{folder / name}: is there already; try: another folder, or remove it first")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if meshes:
            (folder / FOLDER).mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from error
    for mesh in meshes:
        save_mesh(mesh.mesh, folder / mesh.file)
    for name, content in tables.items():
        write_text(folder / name, content)
    write_text(folder / REPORT, report(told.notes, told.left_out))
    write_text(folder / "scene.toml", text)
    told.files = [folder / name for name in names]


def _unused_elements(root: Element, told: Imported, *, recorded: bool) -> Iterator[LeftOut]:
    """The parts of the model that no reader uses, in the file's order, without the muscles that were taken over.

    Of markers, whose recording says which are used, nothing is said where the motion was `recorded` by them.
    """
    taken = {(m.element.tag, m.name) for m in told.muscles if m.name in told.tensions}
    for group in root.children:
        for part in group.objects():
            if group.tag == "ForceSet":
                if part.tag not in _READ and (part.tag, part.name) not in taken:
                    yield _left_out_force(part, told.muscles)
            elif group.tag == "ContactGeometrySet":
                if part.tag != SURFACE:
                    yield LeftOut(part.tag, part.name, f"only <{SURFACE}> is read")
            elif group.tag in _SETS and part.tag not in _READ and not (recorded and group.tag == "MarkerSet"):
                yield LeftOut(part.tag, part.name, _SETS[group.tag])


def _left_out_force(force: Element, muscles: Sequence[PatellarMuscle]) -> LeftOut:
    """Why a force is left out; of one that pulls at the patella also its two ends, for the user to add to the scene."""
    if muscle := next((m for m in muscles if (m.element.tag, m.name) == (force.tag, force.name)), None):
        return LeftOut(force.tag, force.name, muscle.describe())
    if force.tag == "Ligament" or not list(force.all("PathPoint")):
        return LeftOut(force.tag, force.name, f"pftwin has no effect like <{force.tag}>")
    return LeftOut(force.tag, force.name, "it does not pull at the patella; the bones' motion is prescribed")
