"""`pftwin accuracy` and `pftwin hard-cases`."""

from __future__ import annotations

import functools
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from typer import Option

from pftwin.base.errors import InputError
from pftwin.base.runtime import cores, default_cache_dir, describe
from pftwin.cli import terminal
from pftwin.cli.exit_codes import Interrupted, exit_flagged, report_written_on_interrupt
from pftwin.cli.scenes import CaseOption, SceneArgument, allow_outside, limits

if TYPE_CHECKING:
    from pftwin.model.measured import Measured
    from pftwin.model.scene import Scene
    from pftwin.studies.accuracy.measure import SceneOf
    from pftwin.studies.hard_cases import HardCase, Selection
    from pftwin.studies.hard_cases.table import MatrixPiece
    from pftwin.studies.hard_cases.verdict import Cell

OWN = "as it is"  # stands for the contact of the scene file
_tell = functools.partial(terminal.tell, style="dim")


def accuracy(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: Annotated[
        list[str] | None, Option(metavar="NAME", help="P2, P5, P5-cylinder, spline, CM ...; may be repeated.")
    ] = None,
    integrator: Annotated[
        list[str] | None, Option(metavar="NAME", help="May be repeated; default: four common integrators.")
    ] = None,
    dtype: Annotated[
        list[str] | None, Option(metavar="float64|float32", help="May be repeated; default: float64.")
    ] = None,
    full: Annotated[bool, Option("--full", help="Measure all settings; takes half an hour.")] = False,
    folder: Annotated[Path, Option("--out", metavar="DIR", help="Folder for tables and figures.")] = Path("accuracy"),
    json: terminal.JsonOption = None,
) -> None:
    """Measure errors and run times of contact models, integrators, steps and float types; recommends settings.

    Example: `pftwin accuracy --case 1 --contact P5 --out accuracy`
    """
    if scene is not None and case is not None:
        raise InputError("both a scene file and --case given", expected="one of them")
    terminal.check_folder(folder)
    terminal.check_outputs(json)
    terminal.start_computing()
    from pftwin.studies.accuracy.measure import measure_all
    from pftwin.studies.accuracy.programs import COMMON, FLOATS, chosen, full_table
    from pftwin.studies.accuracy.table import advice, overview, write, write_rows

    if full and (contact or integrator or dtype):
        raise InputError(
            "--full given with --contact, --integrator or --dtype", expected="one of them", remedy="omit --full"
        )
    source = _source(scene, case)
    plan = full_table() if full else chosen(contact or [source.own], integrator or COMMON, dtype or FLOATS[:1])
    with report_written_on_interrupt(folder / "accuracy.csv"), terminal.progress("measuring") as shown:
        keep = functools.partial(write_rows, folder=folder)
        found = measure_all(plan, source.scene_of, source.measured, _tell, keep, shown)
    synthetic = source.measured is not None and source.measured.synthetic
    about = {**describe(), "scene": source.title, "synthetic_measurements": int(synthetic)}
    paths = write(found, folder, source.title, about)
    facts = {"about": about, "rows": [asdict(r) for r in found.rows], "files": [str(p) for p in paths]}
    terminal.present(facts, overview(found.rows), advice(found.rows), terminal.written_line(paths), json=json)


class _Source(NamedTuple):
    """The scenes to measure, and the measurements to compare them with."""

    scene_of: SceneOf  # makes a scene from a contact's name
    own: str  # default name of the contact
    measured: Measured | None
    title: str


def _source(scene: Path | None, case: int | None) -> _Source:
    if scene is not None:
        from pftwin.files.scene_file import load_scene_file

        load = functools.partial(load_scene_file, scene, allow_outside=allow_outside.get(), limits=limits.get())
        loaded = load()
        return _Source(
            lambda name: load(contact=None if name == OWN else name).scene, OWN, loaded.measured, loaded.scene.name
        )
    from pftwin import rig
    from pftwin.studies.accuracy.programs import CYLINDER

    n = 1 if case is None else case

    def of_the_rig(name: str) -> Scene:
        return rig.case(
            n, contact=name.removesuffix(CYLINDER), chart="cylinder" if name.endswith(CYLINDER) else "plane"
        )

    return _Source(of_the_rig, "P5", rig.measured(n), f"case {n} of the virtual rig")


def hard_cases(
    *,
    case: Annotated[list[str] | None, Option(metavar="NAME", help="A case; may be repeated; default: all.")] = None,
    contact: Annotated[
        list[str] | None, Option(metavar="NAME", help="A kind of contact; may be repeated; default: all.")
    ] = None,
    integrator: Annotated[
        list[str] | None, Option(metavar="NAME", help="An integrator; may be repeated; default: all.")
    ] = None,
    dtype: Annotated[list[str] | None, Option(metavar="float64|float32", help="A float type; default: both.")] = None,
    list_: Annotated[bool, Option("--list", help="List the cases and their difficulties; run nothing.")] = False,
    quick: Annotated[bool, Option("--quick", help="Check no derivatives and no batches: a third of the time.")] = False,
    into: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="Run what has no file there yet, several contacts in parallel; save it, and show all saved results.",
        ),
    ] = None,
    processes: Annotated[
        int, Option(metavar="N", help="With --into: number of contacts in parallel; default: number of cores.")
    ] = 0,
    from_: Annotated[
        list[Path] | None,
        Option(
            "--from",
            metavar="PATH",
            help="Run nothing; show results saved by --json, from a file or a folder. May be repeated, newest last.",
        ),
    ] = None,
    json: terminal.JsonOption = None,
    markdown: Annotated[Path | None, Option(metavar="FILE", help="Write the page of the documentation.")] = None,
) -> None:
    """Run the catalogue of scenes that are hard to simulate, and report which pass, fail or are refused.

    All of them, with --into DIR, take three quarters of an hour on two cores, mostly to compile; one contact with one
    integrator takes minutes. An interrupted run can be resumed; to run a piece again, remove its file.

    Example: `pftwin hard-cases --contact P5 --integrator linear_implicit --dtype float64`
    """
    terminal.check_outputs(json, markdown)
    terminal.start_computing()
    from pftwin.studies.hard_cases import CONTACTS, DTYPES, INTEGRATORS, case_named, catalogue, table

    cases = tuple(case_named(n) for n in case) if case else catalogue()
    if list_:
        terminal.show(table.named_cases(cases), json=json)
        return
    chosen = _selection(contact, integrator, dtype, quick)
    if into is not None:
        if case or dtype or quick or from_:
            raise InputError("--into given with a part of the matrix", expected="--contact and --integrator at most")
        _run_missing(into, chosen, processes)
        from_ = [into]
    found = [piece for path in from_ for piece in table.read_pieces(path)] if from_ else [_run(cases, chosen, json)]
    order = tuple(c.name for c in catalogue()), CONTACTS, tuple(m.name for m in INTEGRATORS), DTYPES
    cells = table.merged_pieces(found, order)
    if markdown is not None:
        from pftwin.base.text_files import write_text

        write_text(markdown, table.markdown(cells, cases, found))
    terminal.show(table.summary(cells), json=json)
    if failed := table.counts(cells)["fail"]:
        terminal.show(table.reasons(cells, "fail"), json=json)
        exit_flagged(f"{failed} of {len(cells)} cells fail")


def _selection(
    contacts: list[str] | None, integrators: list[str] | None, dtypes: list[str] | None, quick: bool
) -> Selection:
    """The part of the matrix to run; InputError for an unknown name."""
    from pftwin.studies.hard_cases import CONTACTS, DTYPES, INTEGRATORS, Selection, method_named

    methods = tuple(method_named(n) for n in integrators) if integrators else INTEGRATORS
    for method in methods:
        _ = method.integrator  # raises for an unknown name
    return Selection(
        _known(contacts, CONTACTS, "--contact"),
        methods,
        _known(dtypes, DTYPES, "--dtype"),
        derivatives=not quick,
        batch_independence=not quick,
        truths=not quick,
    )


def _run_missing(folder: Path, chosen: Selection, processes: int) -> None:
    """Runs the pieces that the folder lacks, with progress on stderr."""
    from pftwin.studies.hard_cases.whole import run_missing

    options = {"processes": processes or cores(), "cache_dir": default_cache_dir()}
    try:
        with terminal.progress("contacts and integrators") as shown:
            run_missing(folder, chosen, **options, say=_tell, progress=shown)
    except KeyboardInterrupt:
        raise Interrupted(folder) from None


def _run(cases: tuple[HardCase, ...], chosen: Selection, json: str | None) -> MatrixPiece:
    """Runs the selection, contact by contact, with progress on stderr; Ctrl-C keeps the finished contacts."""
    from pftwin.studies.hard_cases import run_matrix
    from pftwin.studies.hard_cases.table import MatrixPiece
    from pftwin.studies.runs import run_each

    began, done, of = time.perf_counter(), 0, chosen.cells_of(cases)
    with terminal.progress("cells") as shown:

        def count(cells: int) -> None:
            nonlocal done
            done += cells
            shown(done, of)

        def one(contact: str) -> list[Cell]:
            return run_matrix(cases, chosen._replace(contacts=(contact,)), _tell, count)

        count(0)
        found = run_each(chosen.contacts, one)
    cells = tuple(cell for of_contact in found for cell in of_contact)
    piece = MatrixPiece(cells, time.perf_counter() - began, describe(), not chosen.derivatives, chosen.truths)
    terminal.write_json(piece.as_dict(), json)
    if len(found) < len(chosen.contacts):
        raise Interrupted(json)
    return piece


def _known(wanted: list[str] | None, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """The requested names, or all if none; InputError for an unknown name."""
    for name in wanted or ():
        if name not in known:
            raise InputError(f"found {name!r}", where=option, expected=f"one of: {', '.join(known)}")
    return tuple(wanted) if wanted else known
