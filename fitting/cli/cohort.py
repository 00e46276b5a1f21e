"""`pftwin cohort`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pftwin.cli.exit_codes import flagged, keeping
from pftwin.cli.scenes import allow_outside
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from fitting.cohort.description import Cohort
    from fitting.cohort.folder import FileFinding
    from fitting.cohort.report import CohortProgress, CohortReport

CohortArgument = Annotated[Path, typer.Argument(metavar="COHORT.toml", help="Patients, fit and treatments.")]


def cohort(
    file: CohortArgument,
    *,
    out_dir: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Results go there, in place of the file's `output`.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on: compute what is missing, failed or out of date.")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Compute nothing; compare files with checksums and keys.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Fit many patients and predict their treatments; go on after a crash where it stopped.

    Writes a NetCDF store for each patient, one table for all (summary.parquet), and a manifest with checksums.
    What fails is listed at the end, and stops no other patient.

    Example: `pftwin cohort cohort.toml --resume`
    """
    check_outputs(json)
    start_computing(batches=True)
    from fitting.cohort.description import read_cohort

    described = read_cohort(file, allow_outside=allow_outside.get())
    folder = described.output if out_dir is None else out_dir
    if check:
        _check(described, folder, json)
    else:
        _run(described, folder, resume, json)


def _run(described: Cohort, folder: Path, resume: bool, json: str | None) -> None:
    from fitting.cohort.manifest import NAME, SUMMARY
    from fitting.cohort.run import run_cohort

    files = [folder / NAME, folder / SUMMARY]
    with keeping(*files), _shown(len(described.patients)) as progress:
        report = run_cohort(described, folder, resume=resume, progress=progress)
    there = [str(p) for p in files if p.is_file()]
    write_json({"cohort": described.name, **report.to_dict(), "files": there}, json)
    console = out(json)
    for line in _said(report, described, there):
        console.print(line, markup=False, highlight=False)
    if report.failed:
        console.print(_table(report))
    if not report.sound:
        count = len(report.failed)
        parts = [f"{count} of {len(report.outcomes)} patients failed"] if count else []
        flagged("; ".join([*parts, *(f"{what} is not up to date: {why}" for what, why in report.unwritten.items())]))


def _said(report: CohortReport, described: Cohort, files: list[str]) -> Iterator[str]:
    done = len(report.outcomes) - len(report.failed)
    computed, kept = sum(o.computed for o in report.outcomes), sum(o.kept for o in report.outcomes)
    yield (
        f"{described.name}: {done} of {len(report.outcomes)} patients done in {_duration(report.seconds)};"
        f" {computed} units computed, {kept} were there"
    )
    yield f"written: {', '.join(files)}"


def _check(described: Cohort, folder: Path, json: str | None) -> None:
    from fitting.cohort.folder import LEFT_OVER, SOUND, check_cohort

    findings = check_cohort(described, folder)
    write_json({"cohort": described.name, "files": [f._asdict() for f in findings]}, json)
    console = out(json)
    wrong = [f for f in findings if f.verdict not in (SOUND, LEFT_OVER)]
    sound = sum(f.verdict == SOUND for f in findings)
    console.print(f"{described.name}: {sound} of {len(findings)} files sound", markup=False, highlight=False)
    if len(findings) > sound:
        console.print(_findings(findings))
    if wrong:
        flagged(f"{len(wrong)} files damaged, out of date or not there; --resume computes them")


@contextmanager
def _shown(patients: int) -> Iterator[Callable[[CohortProgress], None]]:
    """A line on stderr for each unit that ends; on a terminal also a bar with what runs and the time left."""
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    console = err()
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[now]}"))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task(f"{patients} patients: checking what is there", total=None, now="")

        def show(p: CohortProgress) -> None:
            left = "" if p.left is None or p.left < 1.0 else f"about {_duration(p.left)} left"
            what = f"{p.unit.patient}: {p.unit.kind}"
            bar.update(task, description=what, total=p.of, completed=p.number - 1 + p.share, now=left)
            if p.ended:
                ended = _duration(p.seconds) if p.failure is None else "FAILED"
                line = f"[{p.number}/{p.of}] {what}: {ended}{f'; {left}' if left else ''}"
                console.print(line, markup=False, highlight=False, soft_wrap=True)

        yield show


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _table(report: CohortReport) -> Table:
    """What failed, and why."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="failed")
    for name in ("patient", "at"):
        table.add_column(name, no_wrap=True)
    table.add_column("why", overflow="fold")
    for outcome in report.failed:
        assert outcome.failure is not None
        table.add_row(escape(outcome.patient), outcome.failure.stage, escape(outcome.failure.message))
    return table


def _findings(findings: list[FileFinding]) -> Table:
    """All but the sound ones."""
    from rich.markup import escape
    from rich.table import Table

    from fitting.cohort.folder import SOUND

    table = Table()
    for name in ("file", "verdict"):
        table.add_column(name, no_wrap=True)
    table.add_column("", overflow="fold")
    for finding in findings:
        if finding.verdict != SOUND:
            table.add_row(escape(finding.file), finding.verdict, escape(finding.words))
    return table
