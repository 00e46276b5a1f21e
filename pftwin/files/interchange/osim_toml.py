"""The texts of an imported scene: scene.toml, its table of poses, and the list of what was left out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pftwin.files.interchange.osim_knee import OsimKnee
from pftwin.files.interchange.osim_model import LeftOut, OsimContact, OsimLigament, OsimModel, plain_name

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_meshes import Written
    from pftwin.files.interchange.osim_scene import Imported

Floats = NDArray[np.float64]
# Which of OpenSim's axes (x anterior, y proximal, z to the right) are proximal, lateral, anterior.
AXES = {"right": '["+y", "+z", "+x"]', "left": '["+y", "-z", "+x"]'}


class OsimStrand(NamedTuple):
    """A ligament's line, its ends in the frames of patella and other bone [m]."""

    ligament: OsimLigament
    insertion: Floats
    origin: Floats


def scene_text(
    model: OsimModel,
    knee: OsimKnee,
    strands: dict[tuple[str, str], list[OsimStrand]],
    contact: OsimContact | None,
    meshes: Sequence[Written],
    told: Imported,
) -> str:
    """The scene file; adds to the notes what it could not take over as it is."""
    used: set[str] = set()
    tables = [
        _head(model, knee),
        _patella(model, knee, told),
        f"[gravity]\nacceleration_m_per_s2 = {_list(model.gravity)}",
        *(_strands(name, body, group, used) for (name, body), group in strands.items()),
    ]
    if contact is None:
        told.notes.append("contact: none was imported; the scene needs a [contact] of your own")
    else:
        tables.append(_contact(model, contact, meshes, told))
    return "\n\n".join(tables) + "\n"


def _head(model: OsimModel, knee: OsimKnee) -> str:
    axes = AXES[knee.side]
    bodies = "\n\n".join(f"[{part}]\nbody = {json.dumps(part)}" for part in ("femur", "tibia"))
    return "\n".join(
        [
            "# Imported from an OpenSim model; not_imported.md lists what was left out, and why.",
            "schema = 1",
            f"name = {_text(model.name or 'imported')}",
            f'side = "{knee.side}"',
            "",
            "[axes]  # OpenSim's: x anterior, y proximal, z to the right",
            *(f"{part} = {axes}" for part in ("femur", "tibia", "patella")),
            'world_medial_lateral = "z"',
            "",
            "[motion]",
            'poses = "poses.csv"',
            "",
            bodies,
        ]
    )


def _patella(model: OsimModel, knee: OsimKnee, told: Imported) -> str:
    body = model.bodies[knee.patella]
    if np.any(body.inertia[3:]):
        told.notes.append(f"{body.name}: the products of inertia are left out")
    return "\n".join(
        [
            "[patella]",
            f"mass_kg = {_number(body.mass)}",
            f"inertia_kg_m2 = {_list(body.inertia[:3])}",
            f"center_of_mass_m = {_list(body.center)}",
            'start = { body = "patella" }  # where the model has it in the first frame',
        ]
    )


def _strands(name: str, body: str, group: list[OsimStrand], used: set[str]) -> str:
    label = plain_name(name)
    if label in used:
        label = f"{label}_{body}"
    used.add(label)
    of = [s.ligament for s in group]
    return "\n".join(
        [
            f"[[strands]]  # {len(group)}: {_text(of[0].name)}{f' to {_text(of[-1].name)}' if len(group) > 1 else ''}",
            f"name = {json.dumps(label)}",
            f"body = {json.dumps(body)}",
            f"stiffness_N_per_strain = {_list([s.stiffness for s in of])}",
            f"slack_length_m = {_list([s.slack_length for s in of])}",
            f"toe_strain = {_list([s.toe_strain for s in of])}",
            f"damping_time_s = {_list([s.damping_time for s in of])}",
            f"insertion_m = [{', '.join(_list(s.insertion) for s in group)}]",
            f"origin_m = [{', '.join(_list(s.origin) for s in group)}]",
        ]
    )


def _contact(model: OsimModel, contact: OsimContact, meshes: Sequence[Written], told: Imported) -> str:
    layers = [model.surfaces[s] for s in contact.surfaces]
    for layer in layers:
        if layer.variable:
            told.notes.append(f"{layer.mesh.name}: one thickness throughout, {1e3 * layer.thickness:g} mm")
    if contact.lumped:
        told.notes.append(f"{contact.name}: two layers in series; the model lumps both into one of averaged modulus")
    lines = ["[elastic_foundation]", 'name = "contact"', f'law = "{contact.law}"']
    for side, mesh, layer in zip(("femur", "button"), meshes, layers, strict=True):
        lines += [
            f'{side} = {{ mesh = {json.dumps(mesh.file)}, units = "m" }}',
            f"{side}_layer = {{ modulus_MPa = {_number(layer.modulus / 1e6)}, poisson_ratio = {_number(layer.poisson)},"
            f" thickness_m = {_number(layer.thickness)} }}",
        ]
    return "\n".join(lines)


def poses_csv(times: Floats, poses: dict[str, tuple[Floats, Floats]]) -> str:
    """time_s, BODY_px_m ... BODY_qz."""
    names = [f"{b}_{k}" for b in poses for k in ("px_m", "py_m", "pz_m", "qw", "qx", "qy", "qz")]
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


def _text(words: str) -> str:
    """As TOML has it; the words are a stranger's."""
    return json.dumps("".join(c if c.isprintable() else " " for c in words), ensure_ascii=False)


def _number(value: Any) -> str:
    return f"{float(value):.12g}"


def _list(values: Any) -> str:
    return "[" + ", ".join(_number(v) for v in values) + "]"
