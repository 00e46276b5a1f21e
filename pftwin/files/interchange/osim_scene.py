"""Imports an OpenSim model as a scene folder: scene.toml, poses.csv, meshes, and a list of what was not imported."""

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
from pftwin.files.interchange.osim_lines import POINTS, PatellarMuscle, ligament_lines, muscle_lines
from pftwin.files.interchange.osim_model import CONTACT, LIGAMENT, SURFACE, LeftOut, OsimContact, read_model
from pftwin.files.interchange.osim_toml import poses_csv, report, scene_text
from pftwin.files.interchange.osim_wraps import Wraps
from pftwin.files.mocap.trc import trc_text
from pftwin.geometry.mesh.mesh import save_mesh
from pftwin.model.effects.tension import check_knots
from pftwin.model.limits import Limits

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_clusters import MarkerRecording

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
    """The result of an import: files, assumptions, and what was left out."""

    files: list[Path] = field(default_factory=list)  # written
    notes: list[str] = field(default_factory=list)  # assumptions and remarks
    left_out: list[LeftOut] = field(default_factory=list)
    muscles: list[PatellarMuscle] = field(default_factory=list)  # of the patella
    # Tensions of the imported muscles by name, in the first frame [N].
    tensions: dict[str, float] = field(default_factory=dict)

    @property
    def scene(self) -> Path:
        """Path of the scene file."""
        return self.files[0]


def import_osim(
    model: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    motion: str | os.PathLike[str] | None = None,
    rate: float | None = None,
    bend: str | None = None,
    quadriceps: float | None = None,
    quadriceps_knots: Sequence[float] | None = None,
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
    """Writes a scene folder from a model's knee: the patella with its ligaments and contact, and the bones' motion.

    Imported are bodies with mass and meshes, two-point `Blankevoort1991Ligament`s, `Smith2018ContactMesh`es with the
    `Smith2018ArticularContactForce` between femur and patella, joints and coordinates (for the motion and the patella's
    start), `WrapCylinder`, `WrapSphere` and `WrapEllipsoid`. Everything else is listed with the reason.

    Args:
        model: .osim file of OpenSim 4.
        folder: folder of the scene; created if necessary.
        motion: .mot or .sto file of coordinates; or .sto file of the bodies' poses as matrices (BODY_T11 ... BODY_T44),
            in which the patella's poses, if any, become the scene's measurements; or TRC, C3D or CSV file of markers of
            femur and tibia, and optionally of the patella. None: the knee is flexed through its range.
        rate: frames per second, if the times of a file of poses are frame numbers.
        bend: coordinate to flex if there is no motion; None: the first rotation of the tibia's joint.
        quadriceps: constant total tension [N] of the muscles that end on the patella, distributed by their maximum
            isometric forces; lines start at the point before on their paths. None: no such muscles.
        quadriceps_knots: flexions of the knee [deg] at which the scene is to have this tension, each to be changed or
            fitted by itself; at least two, rising. None: one constant tension.
        activation: instead of a tension, the activation of these muscles, 0 to 1, or a STO, MOT or CSV file of
            activations over time, with columns named by the muscles or their paths. Static tensions follow from the
            activations and the lengths of the paths.
        side: "right" or "left"; None: by the end of the patella's name.
        femur, tibia, patella: names of bodies, if they cannot be found automatically.
        geometry: additional folders with meshes, besides the model's and `geometry` in it.
        markers: file with the <MarkerSet> of a recording of markers; None: the model's own.
        units: unit of length of a recording of markers that does not state it.
        without: markers to leave out, by the recording's or the model's names.
        joint_centers: use the centres of hip (from the pelvis' markers) and knee (from the tibia's) as markers of the
            femur, if it has too few good ones.
        limits: limits of plausible knees (`pftwin.model.limits.Limits`), by name, to write to the scene.

    Raises:
        InputError: not an OpenSim 4 model, or one without such a knee; unreadable joints, functions or numbers; missing
            contact meshes; a tension or an activation without a suitable muscle; both a tension and an activation.
        OutputError: the folder cannot be written, or contains one of these files already.
    """
    from pftwin.files.interchange.osim_activation import FILE

    if quadriceps is not None and activation is not None:
        raise InputError("both a tension and an activation", where="activation", expected="one of them")
    if quadriceps_knots is not None:
        if quadriceps is None:
            raise InputError("flexions without a tension", where="quadriceps_knots", expected="quadriceps beside it")
        quadriceps_knots = check_knots(quadriceps_knots, "quadriceps_knots")
    Limits.of(limits or {})
    found = read_model(read_osim(model))
    knee = find_knee(found, side, femur=femur, tibia=tibia, patella=patella)
    imported = Imported(left_out=list(found.left_out))
    places = [Path(p) for p in geometry]
    recording = moved = None
    options: dict[str, Any] = {"units": units, "without": tuple(without), "joint_centers": joint_centers}
    if motion is not None:
        _refuse_others("a motion", bend=bend)
    if motion is not None and Path(motion).suffix.lower() in MARKER_FILES:
        _refuse_others("a recording of markers", rate=rate)
        if activation is not None:
            expected = "coordinates (.mot) or poses (.sto), by which muscles have lengths; or a constant tension"
            raise InputError("an activation, and a recording of markers", where="activation", expected=expected)
        recording = _recording(knee, motion, markers, imported, options)
    else:
        _refuse_others("no recording of markers as motion", markers=markers, **options)
        moved = osim_motion.motion_of(knee, motion, rate, bend)
        imported.notes.append(f"motion: {moved.said}")
    if found.bodies[knee.patella].mass <= 0:
        raise InputError("a patella without mass", where=found.bodies[knee.patella].where, expected="a positive mass")
    wraps = Wraps(knee)
    strands = ligament_lines(knee, wraps, imported)
    contact, pressing = _contact_meshes(knee, places, imported)
    drawn = list(bones(knee, places, {m.file for m in pressing}, imported.left_out))
    if drawn:
        imported.notes.append(f"bones: {len(drawn)} meshes lie in {FOLDER}/; a scene file has no table for them")
    pulling, pulled = muscle_lines(knee, moved, imported, quadriceps, activation, wraps)
    imported.left_out += _unused_elements(found.root, imported, recorded=recording is not None)
    if any(wrap is not None and wrap.kind == "cylinder" for _, wrap in (*strands, *pulling)):
        imported.notes.append("wrapping: cylinders are taken as endless")
    drive = moved, pulling, pulled, recording
    text = scene_text(knee, strands, contact, pressing, imported, *drive, limits or {}, quadriceps_knots or ())
    tables = {} if moved is None else {"poses.csv": poses_csv(moved)}
    tables |= {} if recording is None else {RECORDING: trc_text(RECORDING, recording.markers)}
    if moved is not None and pulled is not None:
        tables[FILE] = pulled.table(moved.times)
    _write(Path(folder), text, tables, [*pressing, *drawn], imported)
    return imported


def _recording(
    knee: OsimKnee,
    motion: str | os.PathLike[str],
    markers: str | os.PathLike[str] | None,
    imported: Imported,
    options: dict[str, Any],
) -> MarkerRecording:
    """Reads the knee's markers and their recording."""
    from pftwin.files.interchange.osim_clusters import read_recording
    from pftwin.files.interchange.osim_markers import markers_of

    known = markers_of(knee, markers, imported.left_out)
    recording = read_recording(motion, knee, known, **options)
    why = "it is not in the recording, or not seen throughout, or was left out"
    imported.left_out += [
        LeftOut("Marker", m.name, why if m.part in PARTS else "it is on no bone of the knee")
        for m in known
        if m.name not in recording.used
    ]
    imported.notes += [f"motion: markers of {os.fspath(motion)}; {osim_motion.GROUND_AS_MODEL}", *recording.notes]
    return recording


def _refuse_others(found: str, **options: Any) -> None:
    """Raises InputError for options that do not apply to a motion."""
    given = [name for name, value in options.items() if value is not None and value is not False and value != ()]
    if given:
        raise InputError(f"{given[0]} given, and {found}", where=given[0], expected="one or the other")


def _contact(knee: OsimKnee, imported: Imported) -> OsimContact | None:
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
        imported.left_out.append(LeftOut(CONTACT, contact.name, why))
    return chosen


def _contact_meshes(knee: OsimKnee, places: list[Path], imported: Imported) -> tuple[OsimContact | None, list[Written]]:
    """The contact with its two meshes; neither if a mesh cannot be read."""
    contact = _contact(knee, imported)
    if contact is None:
        return None, []
    try:
        return contact, [load_mesh(knee.model.surfaces[s].mesh, knee, places) for s in contact.surfaces]
    except InputError as error:
        imported.left_out.append(LeftOut(CONTACT, contact.name, str(error)))
        return None, []


def _write(folder: Path, text: str, tables: dict[str, str], meshes: list[Written], imported: Imported) -> None:
    """Writes all files, or none if one of them exists already."""
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
    write_text(folder / REPORT, report(imported.notes, imported.left_out))
    write_text(folder / "scene.toml", text)
    imported.files = [folder / name for name in names]


def _unused_elements(root: Element, imported: Imported, *, recorded: bool) -> Iterator[LeftOut]:
    """Parts of the model that are not used, in the file's order; without the imported muscles.

    If the motion was `recorded` by markers, they are omitted too, since the recording lists them.
    """
    taken = {(m.element.tag, m.name) for m in imported.muscles if m.name in imported.tensions}
    for group in root.children:
        for part in group.objects():
            if group.tag == "ForceSet":
                if part.tag not in _READ and (part.tag, part.name) not in taken:
                    yield _left_out_force(part, imported.muscles)
            elif group.tag == "ContactGeometrySet":
                if part.tag != SURFACE:
                    yield LeftOut(part.tag, part.name, f"only <{SURFACE}> is read")
            elif group.tag in _SETS and part.tag not in _READ and not (recorded and group.tag == "MarkerSet"):
                yield LeftOut(part.tag, part.name, _SETS[group.tag])


def _left_out_force(force: Element, muscles: Sequence[PatellarMuscle]) -> LeftOut:
    """Why a force is left out; for a muscle of the patella with its two ends, so that users can add it to the scene."""
    if muscle := next((m for m in muscles if (m.element.tag, m.name) == (force.tag, force.name)), None):
        return LeftOut(force.tag, force.name, muscle.describe())
    points = list(force.all("PathPoint"))
    if force.tag == "Ligament" or not points:
        return LeftOut(force.tag, force.name, f"pftwin has no effect like <{force.tag}>")
    places = {(p.words("socket_parent_frame"), *p.numbers_of("location", (0.0, 0.0, 0.0))) for p in points}
    if len(places) == 1 and next(force.all(*POINTS[1:]), None) is None:
        return LeftOut(force.tag, force.name, "its path has no length: all its points are in the same place")
    return LeftOut(force.tag, force.name, "it does not pull at the patella; the bones' motion is prescribed")
