"""The example that `pftwin init` writes: a commented scene file with the virtual rig's recordings and mesh."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pftwin.base.errors import OutputError
from pftwin.files.toml_text import render_toml, toml_list, toml_number

if TYPE_CHECKING:
    from pftwin.geometry.patch.emphasis import WeightedPart


def write_example(folder: Path, case: int = 1) -> list[Path]:
    """Writes scene.toml and its files to a folder, which is created if necessary, and returns their paths.

    Raises:
        OutputError: a file of the same name exists (nothing is written), or the folder is not writable.
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
            targets = [folder / p.name for p in (scene, *files)]
            if there := [t for t in targets if t.exists()]:
                raise OutputError(f"{there[0]}: is there already; try: another folder, or remove it first")
            for source, target in zip((scene, *files), targets, strict=True):
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
    """Returns the commented scene file of one of the rig's cases; it refers to the files of `rig.write_files`.

    The scene's name says "after rig case", because users edit the copy.
    """
    import jax

    from pftwin.geometry.patch.implant import RIG_ANGLES, RIG_HALF_WIDTH, RIG_PARTS, rig_implant
    from pftwin.rig import geometry, recording
    from pftwin.rig.cases import springs
    from pftwin.rig.contacts import rig_law

    markers, forces = recording.recording_files(case)
    hip = {"HIP": geometry.HIP}
    with jax.enable_x64(True):  # the text must not depend on the floating-point type in use
        tendons, law = springs(geometry.CASES[case]), rig_law()
    return render_toml(
        "pftwin.rig",
        "scene.toml.jinja",
        case=case,
        rig=geometry,
        recording=recording,
        markers=markers.name,
        forces=forces.name,
        hip=_cluster(hip),
        femur=_cluster({**geometry.FEMUR_MARKERS, **hip}),
        tibia=_cluster(geometry.TIBIA_MARKERS),
        patella=_cluster(geometry.PATELLA_MARKERS),
        tendons=tendons,
        law=law,
        axis_radius=rig_implant().trochlear_radius,
        half_width=RIG_HALF_WIDTH,
        angles_deg=np.degrees(RIG_ANGLES),
        emphasis=", ".join(_part(p) for p in RIG_PARTS),
    )


def _part(part: WeightedPart) -> str:
    limits = ""
    if math.isfinite(part.across[0]):
        limits += f", across_mm = {toml_list(part.across, 1e3)}"
    if part.angles[1] < math.pi:
        limits += f", angles_deg = {toml_list(np.degrees(part.angles))}"
    return f"{{ weight = {toml_number(part.weight)}{limits} }}"


def _cluster(places: Mapping[str, Sequence[float]]) -> str:
    """A marker cluster as a TOML table: positions in the segment's frame, converted from m to mm."""
    return "{ " + ", ".join(f"{n} = {toml_list(p, 1e3)}" for n, p in places.items()) + " }"
