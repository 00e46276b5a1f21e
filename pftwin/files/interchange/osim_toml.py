"""Text of an imported scene's files: scene.toml, the table of poses, and the list of what was left out."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.files.interchange.osim_knee import PARTS, OsimKnee, Written
from pftwin.files.interchange.osim_lines import OsimStrand, PatellarMuscle
from pftwin.files.interchange.osim_model import LeftOut, OsimContact, valid_name
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_wraps import OsimWrap, of_group
from pftwin.files.toml_text import render_toml

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_activation import Activated
    from pftwin.files.interchange.osim_clusters import MarkerRecording
    from pftwin.files.interchange.osim_scene import Imported

# OpenSim's axes (x anterior, y proximal, z to the right) that are proximal, lateral, anterior.
AXES = {"right": '["+y", "+z", "+x"]', "left": '["+y", "-z", "+x"]'}


class LineGroup(NamedTuple):
    """Ligaments of one name, or muscles, that come from one body and can share a table's obstacle."""

    lines: list[OsimStrand | PatellarMuscle]
    body: str
    wrap: OsimWrap | None


# Limits for a patella whose start is estimated from the model, not recorded.
ANYWHERE = {"most_start_shift_mm": 100.0, "most_start_turn_deg": 90.0}


_FINE = 10_000  # number of triangles of a femur's mesh from which a table of depths is better


def scene_text(
    knee: OsimKnee,
    strands: Sequence[tuple[OsimStrand, OsimWrap | None]],
    contact: OsimContact | None,
    meshes: Sequence[Written],
    imported: Imported,
    moved: Motion | None,
    muscles: Sequence[tuple[PatellarMuscle, OsimWrap | None]],
    pulled: Activated | None,
    recording: MarkerRecording | None,
    limits: Mapping[str, float],
    knots: Sequence[float],
) -> str:
    """Text of the scene file; adds notes on what could not be imported unchanged.

    The scene's measurements are the patella's poses if `moved` has measured ones, or its markers in the `recording`.
    Each strand and muscle comes with its obstacle; tensions over time (`pulled`) are in a separate file. With `knots`,
    flexions of the knee [deg], tensions are given at each of them.
    """
    model = knee.model
    body = model.bodies[knee.patella]
    if np.any(body.inertia[3:]):
        imported.notes.append(f"{body.name}: the products of inertia are left out")
    layers = [] if contact is None else [model.surfaces[s] for s in contact.surfaces]
    if contact is None:
        imported.notes.append("contact: none was imported; the scene needs a [contact] of your own")
    for layer in layers:
        if layer.variable:
            imported.notes.append(f"{layer.mesh.name}: one thickness throughout, {1e3 * layer.thickness:g} mm")
    if contact is not None and contact.lumped:
        note = f"{contact.name}: two layers in series; the model lumps both into one of averaged modulus"
        imported.notes.append(note)
    ligaments = _groups((strand.name, strand, wrap) for strand, wrap in strands)
    pulling = "quadriceps"  # no other effect's name starts with this
    while any(label.startswith(pulling) for label in ligaments):
        pulling += "_muscles"
    pulls = _groups((pulling, muscle, wrap) for muscle, wrap in muscles)
    return render_toml(
        "pftwin.files.interchange",
        "imported.toml.jinja",
        model=model,
        side=knee.side,
        axes=AXES[knee.side],
        patella=body,
        measured=moved is not None and moved.measured,
        synthetic=moved is not None and moved.synthetic,
        recording=recording,
        patella_markers=None if recording is None else _marker_effects(recording.clusters["patella"], ligaments),
        limits={**(ANYWHERE if recording else {}), **limits},
        bodies={part: body_label(knee.name(part)) for part in PARTS},
        tensions={label: [imported.tensions[muscle.name] for muscle in group.lines] for label, group in pulls.items()},
        pulled=pulled,
        knots=knots,
        muscles=pulls,
        ligaments=ligaments,
        contact=contact,
        fine=bool(meshes) and len(meshes[0].mesh.faces) > _FINE,
        sides=list(zip(("femur", "button"), meshes, layers, strict=False)),  # empty without a contact
    )


def _marker_effects(markers: Mapping[str, Floats], labels: Iterable[str]) -> list[tuple[str, str, Floats]]:
    """Name of the effect, name of the marker, and its position, for each marker of the patella."""
    taken, found = {*labels, "contact", "gravity"}, []
    for marker, place in markers.items():
        label = valid_name(marker)
        name = f"{label}_marker" if label in taken or label.startswith("quadriceps") else label
        taken.add(name)
        found.append((name, marker, place))
    return found


def _groups(lines: Iterable[tuple[str, OsimStrand | PatellarMuscle, OsimWrap | None]]) -> dict[str, LineGroup]:
    """Groups lines by name, body and kind of obstacle; keys are unique names."""
    found: dict[str, LineGroup] = {}
    alike: dict[tuple[str, str, tuple[str, ...] | None], list[tuple[OsimStrand | PatellarMuscle, OsimWrap | None]]] = {}
    for name, line, wrap in lines:
        alike.setdefault((name, line.body, wrap and wrap.like), []).append((line, wrap))
    for (name, body, _), group in alike.items():
        wraps = [wrap for _, wrap in group if wrap is not None]
        label = _unlike(valid_name(name), body, found)
        found[label] = LineGroup([line for line, _ in group], body, of_group(wraps) if wraps else None)
    return found


def _unlike(name: str, body: str, taken: Collection[str]) -> str:
    """Makes a name unique by appending the body and a number."""
    tried = (name, f"{name}_{body}", *(f"{name}_{body}_{k}" for k in range(2, len(taken) + 3)))
    return next(label for label in tried if label not in taken)


def body_label(body: str) -> str:
    """Name of a body in the scene's poses: as in the model, so that other recordings of it can be used too."""
    return body if re.fullmatch(r"[\w.-]+", body) else valid_name(body)


def poses_csv(motion: Motion) -> str:
    """CSV text of the poses: time_s, BODY_px_m ... BODY_qz."""
    names = [f"{body_label(b)}_{k}" for b in motion.poses for k in ("px_m", "py_m", "pz_m", "qw", "qx", "qy", "qz")]
    parts = (part for poses in motion.poses.values() for part in (poses.positions, poses.quaternions))
    return csv_text(["time_s", *names], [motion.times, *parts])


def csv_text(names: Sequence[str], columns: Sequence[Floats]) -> str:
    """CSV text of columns (n,) or (n, k), with a header line; numbers with twelve digits."""
    rows = (",".join(f"{v:.12g}" for v in row) for row in np.column_stack(columns))
    return "\n".join([",".join(names), *rows]) + "\n"


def report(notes: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """Markdown text of notes and of what was left out, with one row per kind and reason."""
    head = ["# What was not imported, and why", "", *(f"- {n}" for n in notes), ""]
    cells = ([" ".join(text.replace("|", "/").split()) for text in row] for row in rows(left_out))
    table = ["| what | names | why |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in cells)]
    return "\n".join([*head, *table]) + "\n"


def rows(left_out: Sequence[LeftOut]) -> list[tuple[str, str, str]]:
    """Sorted rows (kind, names, reason), with one row per kind and reason."""

    def alike(part: LeftOut) -> tuple[str, str]:
        return part.kind, part.why

    groups = groupby(sorted(left_out, key=alike), key=alike)
    return [(kind, ", ".join(p.name for p in parts), why) for (kind, why), parts in groups]
