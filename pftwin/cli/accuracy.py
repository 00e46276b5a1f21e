"""`pftwin accuracy`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from pftwin.base.errors import InputError, OutputError
from pftwin.cli.exit_codes import keeping
from pftwin.cli.scenes import CaseOption, SceneArgument, allow_outside
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, working, write_json

if TYPE_CHECKING:
    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene
    from pftwin.studies.accuracy.measure import AccuracyRow, SceneOf

OWN = "as it is"  # a scene file's contact


def accuracy(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: Annotated[
        list[str] | None,
        typer.Option("--contact", metavar="NAME", help="P2, P5, P5-cylinder, spline, CM ...; again for more."),
    ] = None,
    integrator: Annotated[
        list[str] | None, typer.Option("--integrator", metavar="NAME", help="Again for more; the common four.")
    ] = None,
    dtype: Annotated[
        list[str] | None, typer.Option("--dtype", metavar="float64|float32", help="Again for more: float64.")
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Everything; takes half an hour.")] = False,
    folder: Annotated[Path, typer.Option("--out", metavar="DIR", help="For tables and figures.")] = Path("accuracy"),
    json: JsonOption = None,
) -> None:
    """Measure what accuracy costs in time: contact models, integrators, steps and float types, with the best settings.

    Example: `pftwin accuracy --case 1 --contact P5 --out accuracy`
    """
    if scene is not None and case is not None:
        raise InputError("both a scene file and --case given", expected="one of them")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: there is a file of that name; try: another folder")
    check_outputs(json)
    start_computing()
    from pftwin.base.runtime import describe
    from pftwin.studies.accuracy.programs import COMMON, FLOATS, chosen, everything
    from pftwin.studies.accuracy.run import measure_all, write
    from pftwin.studies.accuracy.table import advice, overview

    if full and (contact or integrator or dtype):
        raise InputError("--full given with a choice", expected="one of them", remedy="leave --full out")
    source = _source(scene, case)
    plan = everything() if full else chosen(contact or [source.own], integrator or COMMON, dtype or FLOATS[:1])
    with keeping(folder / "accuracy.csv"), working("measuring"):
        found = measure_all(plan, source.scene_of, source.measured, _tell, lambda rows: _keep(rows, folder))
    synthetic = source.measured is not None and source.measured.synthetic
    about = {**describe(), "scene": source.title, "synthetic_measurements": int(synthetic)}
    paths = write(found, folder, source.title, about)
    write_json({"about": about, "rows": [asdict(r) for r in found.rows], "files": [str(p) for p in paths]}, json)
    out(json).print(overview(found.rows).table())
    out(json).print(advice(found.rows).table())
    out(json).print(f"written: {', '.join(str(p) for p in paths)}", markup=False, highlight=False)


def _tell(line: str) -> None:
    err().print(line, style="dim", markup=False, highlight=False)


def _keep(rows: list[AccuracyRow], folder: Path) -> None:
    """What there is so far, should anything happen to the rest."""
    from pftwin.base.output import written_whole
    from pftwin.studies.accuracy.table import columns
    from pftwin.studies.tables import to_csv

    folder.mkdir(parents=True, exist_ok=True)
    with written_whole(folder / "accuracy.csv") as temporary:
        temporary.write_text(to_csv(columns(rows)), encoding="utf-8")


class _Source(NamedTuple):
    """Where scenes come from."""

    scene_of: SceneOf  # by the contact's name
    own: str  # the contact's name if none is asked for
    measured: Measured | None
    title: str


def _source(scene: Path | None, case: int | None) -> _Source:
    if scene is not None:
        from pftwin.files.scene_file import load_scene_file

        allowed = allow_outside.get()

        def of_the_file(name: str) -> Scene:
            return load_scene_file(scene, contact=None if name == OWN else name, allow_outside=allowed).scene

        loaded = load_scene_file(scene, allow_outside=allowed)
        return _Source(
            of_the_file,
            OWN,
            loaded.measured,
            loaded.scene.name,
        )
    from pftwin import rig
    from pftwin.studies.accuracy.programs import CYLINDER

    n = 1 if case is None else case

    def of_the_rig(name: str) -> Scene:
        if name.endswith(CYLINDER):
            return rig.case(n, contact=name.removesuffix(CYLINDER), chart="cylinder")
        return rig.case(n, contact=name)

    return _Source(of_the_rig, "P5", rig.measured(n), f"case {n} of the virtual rig")
