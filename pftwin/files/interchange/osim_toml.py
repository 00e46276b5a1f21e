"""The texts of an imported scene: scene.toml, its table of poses, and the list of what was left out."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pftwin.base.arrays import Floats
from pftwin.files.interchange.osim_knee import OsimKnee, Written
from pftwin.files.interchange.osim_model import LeftOut, OsimContact, OsimLigament, OsimModel, plain_name
from pftwin.files.interchange.osim_muscles import PatellarMuscle
from pftwin.files.interchange.osim_wraps import OsimWrap, of_group
from pftwin.files.toml_text import render_toml

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_clusters import Recording
    from pftwin.files.interchange.osim_scene import Imported

# Which of OpenSim's axes (x anterior, y proximal, z to the right) are proximal, lateral, anterior.
AXES = {"right": '["+y", "+z", "+x"]', "left": '["+y", "-z", "+x"]'}


class OsimStrand(NamedTuple):
    """A ligament's line, its ends in the frames of patella and other bone [m]."""

    ligament: OsimLigament
    insertion: Floats
    body: str  # the other bone
    origin: Floats
    wrap: OsimWrap | None

    @property
    def name(self) -> str:
        """The ligament's, without the strand's number."""
        return self.ligament.name.rstrip("0123456789") or self.ligament.name


class StrandGroup(NamedTuple):
    """Strands of one ligament, over like obstacles."""

    strands: list[OsimStrand]
    body: str
    wrap: OsimWrap | None


class MuscleGroup(NamedTuple):
    """Muscles from one body, over like obstacles."""

    body: str
    wrap: OsimWrap | None
    muscles: list[PatellarMuscle]


# Limits for a patella whose start is a guess of the model, not a recording.
ANYWHERE = {"most_start_shift_mm": 100.0, "most_start_turn_deg": 90.0}


class OverTime(NamedTuple):
    """Tensions of muscles that change over time."""

    file: str
    moving: set[str]  # bodies on which a muscle's origin moves, so that the file has the origins too


_FINE = 10_000  # triangles of a femur's mesh from which on its depths are better read from a table


def scene_text(
    model: OsimModel,
    knee: OsimKnee,
    strands: Sequence[list[OsimStrand]],
    contact: OsimContact | None,
    meshes: Sequence[Written],
    told: Imported,
    *,
    measured: bool = False,
    muscles: Sequence[tuple[PatellarMuscle, OsimWrap | None]] = (),
    over_time: OverTime | None = None,
    seen: Recording | None = None,
    limits: Mapping[str, float] | None = None,
) -> str:
    """The scene file; adds to the notes what it could not take over as it is.

    Its measurements are the patella's poses, where that was `measured`, or its markers, where they were `seen`. Strands
    come in groups of one name, body and obstacle, muscles each with its obstacle.
    """
    body = model.bodies[knee.patella]
    if np.any(body.inertia[3:]):
        told.notes.append(f"{body.name}: the products of inertia are left out")
    layers = [] if contact is None else [model.surfaces[s] for s in contact.surfaces]
    if contact is None:
        told.notes.append("contact: none was imported; the scene needs a [contact] of your own")
    for layer in layers:
        if layer.variable:
            told.notes.append(f"{layer.mesh.name}: one thickness throughout, {1e3 * layer.thickness:g} mm")
    if contact is not None and contact.lumped:
        told.notes.append(f"{contact.name}: two layers in series; the model lumps both into one of averaged modulus")
    ligaments: dict[str, StrandGroup] = {}
    for group in strands:
        wraps, body_of = [s.wrap for s in group if s.wrap is not None], group[0].body
        label = _unlike(plain_name(group[0].name), body_of, ligaments)
        ligaments[label] = StrandGroup(group, body_of, of_group(wraps) if wraps else None)
    return render_toml(
        "pftwin.files.interchange",
        "imported.toml.jinja",
        model=model,
        side=knee.side,
        axes=AXES[knee.side],
        patella=body,
        measured=measured,
        seen=None if seen is None else _seen_markers(seen, list(ligaments)),
        limits={**(ANYWHERE if seen else {}), **(limits or {})},
        bodies={knee.part(body): body_label(body) for body in (knee.femur, knee.tibia, knee.patella)},
        tensions=told.tensions,
        over_time=over_time,
        muscles=_pulling(muscles, _free_name(list(ligaments))),
        ligaments=ligaments,
        contact=contact,
        fine=bool(meshes) and len(meshes[0].mesh.faces) > _FINE,
        sides=list(zip(("femur", "button"), meshes, layers, strict=False)),  # none without a contact
    )


class SeenMarkers(NamedTuple):
    """What the scene file says of a recording of markers."""

    clusters: dict[str, dict[str, Floats]]  # of femur and tibia: places by name
    cutoff: float | None
    order: int
    position: Floats  # of the patella in the femur, at the start [m]
    quaternion: Floats
    patella: list[tuple[str, str, Floats]]  # name of the effect, of the marker, and its place


def _seen_markers(seen: Recording, labels: Sequence[str]) -> SeenMarkers:
    from pftwin.files.interchange.osim_clusters import ORDER

    turn = Rotation.from_matrix(seen.start[:3, :3]).as_quat(scalar_first=True, canonical=True)
    taken, names = {*labels, "contact", "gravity"}, {}
    for marker in seen.clusters["patella"]:
        label = plain_name(marker)
        names[marker] = f"{label}_marker" if label in taken or label.startswith("quadriceps") else label
        taken.add(names[marker])
    markers = [(names[m], m, place) for m, place in seen.clusters["patella"].items()]
    return SeenMarkers(seen.clusters, seen.cutoff, ORDER, seen.start[:3, 3], turn, markers)


def _free_name(labels: Sequence[str]) -> str:
    """A name for what pulls, with which no other effect's begins."""
    name = "quadriceps"
    while any(label.startswith(name) for label in labels):
        name += "_muscles"
    return name


def _pulling(muscles: Sequence[tuple[PatellarMuscle, OsimWrap | None]], name: str) -> dict[str, MuscleGroup]:
    """Groups of muscles from one body and over like obstacles, by names that begin alike."""
    found: dict[str, MuscleGroup] = {}
    for body, like in dict.fromkeys((m.body, w and w.like) for m, w in muscles):
        group = [(m, w) for m, w in muscles if (m.body, w and w.like) == (body, like)]
        wraps = [w for _, w in group if w is not None]
        found[_unlike(name, body, found)] = MuscleGroup(body, of_group(wraps) if wraps else None, [m for m, _ in group])
    return found


def _unlike(name: str, body: str, taken: Collection[str]) -> str:
    """A name that is not taken: by the body, and a number."""
    tried = (name, f"{name}_{body}", *(f"{name}_{body}_{k}" for k in range(2, len(taken) + 3)))
    return next(label for label in tried if label not in taken)


def body_label(body: str) -> str:
    """What a body is called in the scene's poses: as in the model, so that other recordings of it serve as well."""
    return body if re.fullmatch(r"[\w.-]+", body) else plain_name(body)


def poses_csv(times: Floats, poses: dict[str, tuple[Floats, Floats]]) -> str:
    """time_s, BODY_px_m ... BODY_qz."""
    names = [f"{body_label(b)}_{k}" for b in poses for k in ("px_m", "py_m", "pz_m", "qw", "qx", "qy", "qz")]
    rows = np.column_stack([times, *(part for pair in poses.values() for part in pair)])
    lines = [",".join(f"{v:.12g}" for v in row) for row in rows]
    return "\n".join([",".join(["time_s", *names]), *lines]) + "\n"


def report(notes: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Markdown: what was assumed, and what was left out, those of one kind and reason in one row."""
    lines = [
        "# What was not imported, and why",
        "",
        *(f"- {n}" for n in notes),
        "",
        "| what | names | why |",
        "|---|---|---|",
    ]
    return "\n".join([*lines, *("| " + " | ".join(_cell(c) for c in row) + " |" for row in rows(left_out))]) + "\n"


def rows(left_out: Sequence[LeftOut]) -> list[tuple[str, str, str]]:
    """Kind, names, reason; sorted, those of one kind and reason together."""

    def alike(part: LeftOut) -> tuple[str, str]:
        return part.kind, part.why

    groups = groupby(sorted(left_out, key=alike), key=alike)
    return [(kind, ", ".join(p.name for p in parts), why) for (kind, why), parts in groups]


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "/").split())
