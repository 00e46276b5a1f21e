"""What pulls at the patella in an OpenSim model: its ligaments in groups, and its muscles; each with its obstacle."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_knee import OsimKnee, part_and_pose
from pftwin.files.interchange.osim_model import LIGAMENT, LeftOut, OsimModel
from pftwin.files.interchange.osim_motion import Motion
from pftwin.files.interchange.osim_muscles import PatellarMuscle, muscles_of, shared_tensions
from pftwin.files.interchange.osim_wraps import OsimWrap, Wraps

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_activation import Activated
    from pftwin.files.interchange.osim_scene import Imported
    from pftwin.files.interchange.osim_toml import OsimStrand


def pulls(
    root: Element,
    model: OsimModel,
    knee: OsimKnee,
    moved: Motion | None,
    told: Imported,
    quadriceps: float | None,
    activation: float | str | os.PathLike[str] | None,
    wraps: Wraps,
) -> tuple[list[tuple[PatellarMuscle, OsimWrap | None]], Activated | None]:
    """The muscles that pull at the patella with their obstacles: a tension of all, or over time by activation."""
    muscles = told.muscles = list(muscles_of(root, model, knee))
    pulled = None
    if quadriceps is not None:
        told.tensions = shared_tensions(muscles, quadriceps)
        each = ", ".join(f"{name} {newtons:.3g} N" for name, newtons in told.tensions.items())
        told.notes.append(f"tensions, constant, by maximum isometric force: {each}")
    elif activation is not None and moved is not None:
        from pftwin.files.interchange.osim_activation import activated

        pulled = activated(root, model, knee, moved, muscles, activation, wraps)
        told.tensions = {m.name: float(t) for m, t in zip(pulled.muscles, pulled.tensions[0], strict=True)}
        told.notes += pulled.notes
    if told.tensions and (without := [m.name for m in muscles if m.name not in told.tensions]):
        told.notes.append(f"without a tension: {', '.join(without)}")
    pulling = [m for m in muscles if m.name in told.tensions] if pulled is None else pulled.muscles
    return list(_wrapped(pulling, wraps, told)), pulled


def ligament_groups(model: OsimModel, knee: OsimKnee, wraps: Wraps, told: Imported) -> list[list[OsimStrand]]:
    """Ligaments of the patella; those of one name without its number, other body and obstacle are one group."""
    from pftwin.files.interchange.osim_toml import OsimStrand

    groups: dict[tuple[str, str, tuple[str, ...] | None], list[OsimStrand]] = {}
    straight: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for ligament in model.ligaments:
        ends = [(part_and_pose(model, knee, frame), point) for frame, point in ligament.ends]
        places = [(part, pose[:3, :3] @ point + pose[:3, 3]) for (part, pose), point in ends]
        parts = [part for part, _ in places]
        if parts.count("patella") != 1 or not {*parts} - {"patella"} <= {"femur", "tibia", "ground"}:
            told.left_out.append(LeftOut(LIGAMENT, ligament.name, _why_not(parts)))
            continue
        k = parts.index("patella")
        over, left = wraps.over(ligament.wraps)
        strand = OsimStrand(ligament, places[k][1], *places[1 - k], over)
        straight.setdefault((strand.name, tuple(left)), []).append(ligament.name)
        groups.setdefault((strand.name, strand.body, over and over.like), []).append(strand)
    told.notes += _straight(straight)
    return list(groups.values())


def _wrapped(
    muscles: Sequence[PatellarMuscle], wraps: Wraps, told: Imported
) -> Iterator[tuple[PatellarMuscle, OsimWrap | None]]:
    """Muscles with their obstacles."""
    for muscle in muscles:
        over, left = wraps.over(muscle.wraps)
        told.notes += _straight({(muscle.name, tuple(left)): [muscle.name]})
        yield muscle, over


def _straight(lines: dict[tuple[str, tuple[str, ...]], list[str]]) -> Iterator[str]:
    """What is said of lines by their common name and the objects over which they do not wrap."""
    for (_, objects), names in lines.items():
        if objects:
            which = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]} ({len(names)} strands)"
            yield f"{which}: not wrapped over {', '.join(objects)}"


def _why_not(parts: list[str]) -> str:
    if "patella" not in parts:
        return f"it joins {' and '.join(parts)}, whose motion is prescribed"
    return f"it joins {' and '.join(parts)}: pftwin knows femur, tibia and ground beside the patella"
