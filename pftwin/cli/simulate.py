"""`pftwin simulate`, `pftwin equilibrium` and `pftwin validate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import check_trust, exit_flagged, report_written_on_interrupt
from pftwin.cli.plugins import with_scene_changes
from pftwin.cli.scenes import RunOptions, SceneOptions, ToleranceOption, on_scene, simulated
from pftwin.cli.terminal import AxesOption, JsonOption, check_outputs, check_suffix, present, spinner, written_line

if TYPE_CHECKING:
    from pftwin.cli.scenes import Chosen
    from pftwin.dynamics.equilibrium_report import EquilibriumReport
    from pftwin.model.scene import Scene
    from pftwin.results.metrics import Validation
    from pftwin.results.result import Result


@with_scene_changes
@on_scene
def simulate(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="OUT.nc", help="NetCDF file for the result.")],
    knee: RunOptions,
    tolerance: ToleranceOption = None,
    change: Callable[[Any], Any] | None = None,
    csv: Annotated[bool, Option("--csv", help="Also write a table, OUT.csv.")] = False,
    sto: Annotated[bool, Option("--sto", help="Also write an OpenSim file, OUT.sto.")] = False,
    axes: AxesOption = "pftwin",
    json: JsonOption = None,
) -> None:
    """Simulate the patella in the recorded motion, with or without a treatment.

    Amounts of treatments may have a unit: "16 mm", "1.6 cm".

    Example: `pftwin simulate --case 2 --tto-medial 16 -o after.nc`
    """
    check_suffix(output, [".nc"], "results are NetCDF")
    from pftwin.files.result_files import check_axes

    files = [output, *(output.with_suffix(s) for s, wanted in ((".csv", csv), (".sto", sto)) if wanted)]
    if check_axes(axes) != "pftwin" and not (csv or sto):
        raise InputError(f"found {axes!r}, and no table", where="--axes", expected="--csv or --sto")
    check_outputs(*files, json)
    chosen = knee.load()
    chosen = chosen if change is None else replace(chosen, scene=change(chosen.scene))
    result, first = simulated(chosen, knee, tolerance)
    with report_written_on_interrupt(*files), spinner("writing"):
        result.save(output)
        for path in files[1:]:
            {".csv": result.to_csv, ".sto": result.to_sto}[path.suffix](path, axes)
    present(_facts(result, chosen, first, files), result.summary(), written_line(files), json=json)
    check_trust(result)


def _facts(result: Result, chosen: Chosen, first: float, files: list[Path]) -> dict[str, Any]:
    """Facts about a run for the JSON of commands that run one scene."""
    from pftwin.dynamics.status import status_facts

    return {
        "scene": result.scene_name,
        "contact": chosen.contact,
        "frames": result.times.size,
        "duration_s": result.duration,
        "settings": result.settings,
        "timing": {**result.timing, "first_run_s": first},
        "real_time_factor": result.real_time_factor,
        "verdict": result.verdict.describe(),
        "tracking": result.tracking,
        "start_overlap": result.start_overlap,
        **status_facts(result.flags),
        "largest_indentation_m": result.largest_indentation,
        "estimated_error": _largest_errors(result),
        "equilibrium": result.equilibrium.to_dict(),
        "dtype": result.dtype,
        "files": [str(p) for p in files],
    }


def _largest_errors(result: Result) -> dict[str, float | None] | None:
    """Largest estimated errors over all frames; None if not estimated."""
    if result.error is None:
        return None
    units = {"path": "m"}
    return {f"{k}_{units.get(k, 'N')}": v if isfinite(v) else None for k, v in result.error.largest.items()}


@on_scene
def equilibrium(*, knee: SceneOptions, json: JsonOption = None) -> None:
    """Find the static equilibrium at the first frame of the motion.

    Example: `pftwin equilibrium --case 2 --contact P4`
    """
    check_outputs(json)
    chosen = knee.load()
    from pftwin.dynamics.equilibrium_report import invalid_start, start_overlap
    from pftwin.dynamics.simulate import equilibrium as solve
    from pftwin.dynamics.status import Status
    from pftwin.results.verdict import INVALID, verdict_of

    name = chosen.scene.name
    with spinner(f"solving for the equilibrium of {name}"):
        report = solve(chosen.scene)
    rows = (
        ("patella in the femur [mm]", "  ".join(f"{1e3 * v:.3f}" for v in report.position)),
        ("quaternion (w, x, y, z)", "  ".join(f"{v:.6f}" for v in report.quaternion)),
        ("residual [N]", f"{report.residual:.1e} after {report.iterations} iterations"),
        *_reported(report, chosen.scene),
    )
    sheet = Sheet("", ("quantity", "value"), rows)
    start = Status(0) if report.converged else Status.START_NOT_IN_EQUILIBRIUM
    verdict = verdict_of([report.status | start], invalid_start(chosen.scene, report))  # as of a motion from there
    overlap = start_overlap(chosen.scene)
    remark = f"remark: {overlap}" if overlap and overlap not in verdict.reasons else ""
    facts = {"scene": name, "contact": chosen.contact, "verdict": verdict.describe(), "start_overlap": overlap}
    first_line = "" if verdict.valid else verdict.describe()
    present(facts | report.to_dict(), first_line, f"{name}: {report.description}", remark, sheet, json=json)
    if not report.converged:
        exit_flagged(f"{name}: no equilibrium was found; try: a start pose nearer to where the patella rests")
    if not verdict.valid:
        exit_flagged(f"{name} is {INVALID}")


def _reported(report: EquilibriumReport, scene: Scene) -> list[tuple[str, str]]:
    """Rows of the effects' observables with one number, in the units shown to readers."""
    from pftwin.base.quantities import shown

    units = {effect.name: {key: about.unit for key, about in effect.observables.items()} for effect in scene.effects}
    return [
        (
            f"{name} {key}".replace("_", " "),
            "none" if isnan(value) else shown(float(value), units[name].get(key, "1"), 6),  # nan: nothing touches there
        )
        for name, observables in report.effects.items()
        for key, value in observables.items()
        if value.ndim == 0
    ]


@on_scene
def validate(
    *,
    output: Annotated[
        Path | None, Option("-o", "--output", metavar="OUT.nc", help="NetCDF file for the simulated result.")
    ] = None,
    knee: RunOptions,
    tolerance: ToleranceOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate, and compare with the measurements; with --case, beside Table 1 of Michaud et al. 2024.

    For a skin marker over the patella, only the shape of its time course is compared, not its position.

    Example: `pftwin validate --case 1 --contact P5`
    """
    files = [] if output is None else [output]
    for path in files:
        check_suffix(path, [".nc"], "results are NetCDF")
    check_outputs(*files, json)
    chosen = knee.load()
    measured = chosen.scene.measured
    if measured is None:
        raise InputError("nothing to compare with", where=knee.scene, expected="a table [measured] in the scene file")
    from pftwin.results.metrics import PAPER_TABLE_1
    from pftwin.results.metrics import validate as compare

    result, first = simulated(chosen, knee, tolerance)
    names = {e.name for e in chosen.scene.effects}
    springs: dict[str, Any] = {}
    if measured.tibial_spring_force is None and "patellar_tendon" not in names:
        springs["tibial"] = None
    if measured.femoral_spring_force is None and "quadriceps" not in names:
        springs["femoral"] = None
    found = compare(result, measured, **springs)
    paper = chosen.contact if knee.case is not None and chosen.contact in PAPER_TABLE_1 else None
    rows = found.to_rows(paper)
    if knee.case is None:  # springs on the femur's and the tibia's side are the rig's
        rows = [row._replace(label=_OWN_LABELS.get(row.key, row.label)) for row in rows]
    if found.mean_distance is None:  # with only skin markers, most of these rows are empty
        rows = [row for row in rows if row.value is not None]
    beside = [] if paper is None else [f"paper, {paper}"]  # the paper's means over its four cases
    cells = [(r.label, *(_number(v) for v in (r.value, r.paper)[: 1 + len(beside)]), r.unit) for r in rows]
    against = "synthetic measurements" if found.synthetic else "measurements"
    headings = ("", "this", *beside, "unit")
    sheet = Sheet(f"{found.scene} against {against}", headings, tuple(cells), words=(0, len(headings) - 1))
    shown = [row._asdict() for row in rows]
    with report_written_on_interrupt(*files):
        for path in files:
            result.save(path)
    facts = {**_facts(result, chosen, first, files), **found.to_dict(), "rows": shown}
    facts["side_as_given"] = chosen.side_as_given
    first_lines = [*([] if result.verdict.valid else [result.verdict.describe()]), *found.doubts]
    first_lines += [f"remark: {result.start_overlap}"] if result.start_overlap else []
    skin = _skin_sheet(found) if found.skin_markers else ("", "")
    present(facts, "\n".join(first_lines), sheet, *skin, written_line(files), json=json)
    check_trust(result)
    if found.doubts:
        exit_flagged(f"{found.doubts[0]} ({result.scene_name})")


_OWN_LABELS = {"tibial_spring": "patellar tendon force RMSE", "femoral_spring": "quadriceps force RMSE"}


def _skin_sheet(found: Validation) -> tuple[Sheet, str]:
    """Table that compares the time courses of skin markers, with a note on its limits."""
    from pftwin.results.skin_markers import QUALITATIVE

    headings = ("", "correlation", "range measured", "range simulated", "rms less mean offset", "unit")
    rows = tuple(
        (
            f"{m.key} ({m.words})",
            *(_number(v) for v in (m.correlation, m.measured_range, m.simulated_range, m.rms_about_mean)),
            m.unit,
        )
        for m in found.skin_markers
    )
    return Sheet("markers on the skin", headings, rows, words=(0, len(headings) - 1)), QUALITATIVE


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
