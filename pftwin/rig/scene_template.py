"""The example that `pftwin init` writes: a commented scene file beside the files of the virtual rig's laboratory."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import OutputError

if TYPE_CHECKING:
    from pftwin.base.spatial import Vec3
    from pftwin.geometry.patch.emphasis import WeightedPart

Cluster = Mapping[str, Sequence[float]]  # markers' places in the frame of their segment [m]


def write_example(folder: Path, case: int = 1) -> list[Path]:
    """Write scene.toml and its files; the folder is made if it is not there.

    Raises:
        OutputError: a file of the same name is there already (nothing is written), or the folder cannot be written to.
    """
    from pftwin import rig

    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".example.") as name:
            built = Path(name)
            files = [Path(p) for p in rig.write_files(case, built)]
            scene = built / "scene.toml"
            scene.write_text(scene_text(case), encoding="utf-8")
            targets = [folder / p.relative_to(built) for p in (scene, *files)]
            if there := [t for t in targets if t.exists()]:
                raise OutputError(f"{there[0]}: is there already; try: another folder, or remove it first")
            for source, target in zip((scene, *files), targets, strict=True):
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.move(source, target)
            return targets
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
    finally:
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def scene_text(case: int) -> str:
    """The scene file of one of the rig's cases, with comments, beside the files that `rig.write_files` writes.

    It is named after the case, not as the case: an edited copy is none.
    """
    from jinja2 import Environment, PackageLoader

    from pftwin.geometry.patch.implant import RIG_ANGLES, RIG_HALF_WIDTH, RIG_PARTS, rig_implant
    from pftwin.rig import geometry, recording
    from pftwin.rig.cases import springs
    from pftwin.rig.contacts import rig_law

    markers, forces = recording.recording_files(case)
    hip = {"HIP": geometry.HIP}
    environment = Environment(loader=PackageLoader("pftwin.rig", ""), keep_trailing_newline=True, autoescape=False)
    environment.filters |= {"number": _number, "point": _point, "cluster": _cluster, "part": _part}
    return environment.get_template("scene.toml.jinja").render(
        case=case,
        rig=geometry,
        recording=recording,
        markers=markers.name,
        forces=forces.name,
        hip=hip,
        femur={**geometry.FEMUR_MARKERS, **hip},
        tendons=springs(geometry.CASES[case]),
        law=rig_law(),
        axis_radius=rig_implant().trochlear_radius,
        half_width=RIG_HALF_WIDTH,
        angles_deg=[math.degrees(a) for a in RIG_ANGLES],
        parts=RIG_PARTS,
    )


def _number(value: Any, scale: float = 1.0) -> str:
    return f"{scale * float(value):.10g}"


def _point(v: Vec3 | Sequence[float], scale: float = 1.0) -> str:
    values = v if isinstance(v, Sequence) else np.asarray(v.array())
    return "[" + ", ".join(_number(c, scale) for c in values) + "]"


def _part(part: WeightedPart) -> str:
    limits = ""
    if math.isfinite(part.across[0]):
        limits += f", across_mm = {_point(part.across, 1e3)}"
    if part.angles[1] < math.pi:
        limits += f", angles_deg = {_point(part.angles, 180 / math.pi)}"
    return f"{{ weight = {_number(part.weight)}{limits} }}"


def _cluster(places: Cluster) -> str:
    return "{ " + ", ".join(f"{n} = {_point(p, 1e3)}" for n, p in places.items()) + " }"
