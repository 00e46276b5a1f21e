"""`pftwin cohort`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import exit_flagged, report_written_on_interrupt
from pftwin.cli.scenes import allow_outside, limits
from pftwin.cli.terminal import JsonOption, check_outputs, present, progress, start_computing, tell, written_line

if TYPE_CHECKING:
    from fitting.cohort.description import Cohort
    from fitting.cohort.report import CohortProgress


def cohort(
    file: Annotated[Path, Argument(metavar="COHORT.toml", help="Patients, fit and treatments.")],
    *,
    out_dir: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Folder of the results, instead of the file's `output`.")
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Compute only what is missing, failed or outdated.")] = False,
    check: Annotated[bool, Option("--check", help="Compute nothing; verify files against checksums and keys.")] = False,
    json: JsonOption = None,
) -> None:
    """Fit many patients and predict their treatments; after a crash, `--resume` continues where it stopped.

    Writes a NetCDF store for each patient, one table for all (summary.parquet), and a manifest with checksums.
    A patient that fails is listed at the end and does not stop the others.

    Example: `pftwin cohort cohort.toml --resume`
    """
    check_outputs(json)
    start_computing(batches=True)
    from fitting.cohort.description import read_cohort

    described = read_cohort(file, allow_outside=allow_outside.get(), limits=limits.get())
    folder = described.output if out_dir is None else out_dir
    why = _check(described, folder, json) if check else _run(described, folder, resume, json)
    if why:
        exit_flagged(why)


def _run(described: Cohort, folder: Path, resume: bool, json: str | None) -> str:
    """Runs the cohort; returns a description of what failed, empty if nothing did."""
    from fitting.cohort.manifest import NAME, SUMMARY
    from fitting.cohort.run import run_cohort

    files = [folder / NAME, folder / SUMMARY]
    with (
        report_written_on_interrupt(*files),
        progress(f"{len(described.patients)} patients: checking existing results") as shown,
    ):

        def show(p: CohortProgress) -> None:
            left = "" if p.left is None or p.left < 1.0 else f"about {_duration(p.left)} left"
            what = f"{p.unit.patient}: {p.unit.kind}"
            shown(p.number - 1 + p.share, p.of, left, what)
            if p.ended:
                ended = _duration(p.seconds) if p.failure is None else "FAILED"
                tell(f"[{p.number}/{p.of}] {what}: {ended}{f'; {left}' if left else ''}")

        report = run_cohort(described, folder, resume=resume, progress=show)
    there = [str(p) for p in files if p.is_file()]
    total, failed = len(report.outcomes), len(report.failed)
    computed, kept = sum(o.computed for o in report.outcomes), sum(o.kept for o in report.outcomes)
    summary = (
        f"{described.name}: {total - failed} of {total} patients done in {_duration(report.seconds)};"
        f" {computed} units computed, {kept} up to date"
    )
    failures = [(o.patient, o.failure.stage, o.failure.message) for o in report.failed if o.failure is not None]
    tables = [Sheet("failed", ("patient", "at", "why"), tuple(failures))] if failures else []
    bounds = tuple((o.patient, ", ".join(o.at_bounds)) for o in report.outcomes if o.at_bounds)
    title = "estimates at a bound; the true value may lie beyond"
    tables += [Sheet(title, ("patient", "parameters"), bounds, words=(0, 1))] if bounds else []
    facts = {"cohort": described.name, **report.to_dict(), "files": there}
    present(facts, summary, written_line(there), *tables, json=json)
    if report.sound:
        return ""
    parts = [f"{failed} of {total} patients failed"] if failed else []
    return "; ".join([*parts, *(f"{what} is not up to date: {why}" for what, why in report.unwritten.items())])


def _check(described: Cohort, folder: Path, json: str | None) -> str:
    """Verifies files against checksums and keys; returns a description of what is wrong, empty if nothing is."""
    from fitting.cohort.folder import LEFT_OVER, SOUND, check_cohort

    findings = check_cohort(described, folder)
    others = [f for f in findings if f.verdict != SOUND]
    wrong = [f for f in others if f.verdict != LEFT_OVER]
    summary = f"{described.name}: {len(findings) - len(others)} of {len(findings)} files sound"
    tables = [Sheet("", ("file", "verdict", ""), tuple(others))] if others else []
    facts = {"cohort": described.name, "files": [f._asdict() for f in findings]}
    present(facts, summary, *tables, json=json)
    return f"{len(wrong)} files damaged, out of date or missing; --resume computes them" if wrong else ""


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
