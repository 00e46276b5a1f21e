"""The program `pftwin`: its commands, and how errors reach the user."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from pftwin.cli import (
    accuracy,
    audit,
    cohort,
    contact_map,
    demo,
    doctor,
    doctor_mesh,
    equilibrium,
    explain,
    export,
    fit,
    fit_surface,
    hard_cases,
    import_model,
    init,
    optimise,
    plan_experiment,
    simulate,
    treat,
    validate,
    view,
)
from pftwin.cli.exit_codes import ExitCode, after_interrupt, code_of, leave_at_once
from pftwin.cli.live import command as live
from pftwin.cli.report import command as report
from pftwin.cli.scenes import allow_outside
from pftwin.cli.terminal import err
from pftwin.errors import PftwinError, PftwinWarning

# The help's table of contents: by panel, each command with a line that fits a terminal of 80 columns.
COMMANDS: dict[str, tuple[tuple[str, Callable[..., None], str], ...]] = {
    "Start": (
        ("demo", demo.demo, "The whole story on the virtual rig, beside the paper"),
        ("init", init.init, "Write a commented scene with a laboratory's files"),
        ("doctor", doctor.doctor, "Is this installation sound? Versions and a self-test"),
    ),
    "Simulate": (
        ("simulate", simulate.simulate, "The patella through the recorded motion"),
        ("equilibrium", equilibrium.equilibrium, "Where the patella rests at the first frame"),
        ("validate", validate.validate, "Simulate, and compare with measurements"),
        ("contact-map", contact_map.contact_map, "Pressures where recorded poses press two meshes"),
    ),
    "Fit": (
        ("fit", fit.fit, "Tendons from motion capture, with intervals"),
        ("plan-experiment", plan_experiment.plan_experiment, "What an experiment can tell, before it is made"),
        ("fit-surface", fit_surface.fit_surface, "Trochlear patches from a mesh of the implant"),
    ),
    "Treat": (
        ("treat", treat.treat, "Predict outcomes of treatments, with bands"),
        ("optimise", optimise.optimise, "The smallest treatment that meets stated limits"),
        ("cohort", cohort.cohort, "Many patients: fits, treatments, one summary"),
        ("app", live.app, "Treatments by sliders, live in the browser"),
    ),
    "Look": (
        ("view", view.view, "Results in three dimensions: a page, offline"),
        ("report", report.report, "One offline page that a clinician can read"),
        ("explain", explain.explain, "What each effect of a scene adds"),
        ("audit", audit.audit, "What each effect is worth, left out in turn"),
    ),
    "Check": (
        ("doctor-mesh", doctor_mesh.doctor_mesh, "What is wrong with a mesh; repair what is safe"),
        ("accuracy", accuracy.accuracy, "What accuracy costs in time"),
        ("hard-cases", hard_cases.hard_cases, "Scenes that break simulators, judged"),
    ),
    "Exchange": (
        ("export", export.export, "A result as .mot, .sto, .glb or .csv"),
        ("import", import_model.import_model, "An OpenSim model as a scene folder"),
    ),
}


class _Commands(TyperGroup):
    """Errors meant for the user, and Ctrl-C, become a line on stderr and an exit code; others keep their traceback."""

    def invoke(self, ctx: Any) -> Any:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            try:
                return super().invoke(ctx)
            except PftwinError as error:
                err().print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
                raise typer.Exit(code_of(error)) from None
            except KeyboardInterrupt as error:
                after_interrupt(error)


_show_elsewhere = warnings.showwarning


def _show_warning(message: Any, category: Any, *rest: Any, **options: Any) -> None:
    if isinstance(message, PftwinWarning):
        err().print(f"warning: {message}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    else:
        _show_elsewhere(message, category, *rest, **options)


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    help="Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from pftwin import __version__

        sys.stdout.write(f"pftwin {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and end.")
    ] = False,
    outside: Annotated[
        bool, typer.Option("--allow-outside", help="Let a scene file name files outside its folder: one you trust.")
    ] = False,
) -> None:
    """Digital twin of the patellofemoral joint: motion capture in, patellar tracking and forces out."""
    allow_outside.set(outside)


for _panel, _commands in COMMANDS.items():
    for _name, _command, _line in _commands:
        app.command(_name, short_help=_line, rich_help_panel=_panel)(_command)


def main() -> None:
    """The entry point of the program."""
    try:
        app(prog_name="pftwin")
    except SystemExit as ended:
        if ended.code == ExitCode.INTERRUPTED:
            leave_at_once(ExitCode.INTERRUPTED)
        raise
