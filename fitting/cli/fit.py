"""`pftwin fit`, `pftwin plan-experiment` and `pftwin train-posterior`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from fitting.cli.fit_options import DuringOption, ExperimentOptions, FitOptions, refuse_settled, time_spans, within
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import Interrupted, exit_flagged, report_written_on_interrupt
from pftwin.cli.scenes import on_scene
from pftwin.cli.terminal import (
    JsonOption,
    check_outputs,
    check_suffix,
    present,
    progress,
    progress_callback,
    spinner,
    written_line,
)

if TYPE_CHECKING:
    from fitting.estimate import Estimate
    from fitting.fit import Progress
    from fitting.posterior.result import Posterior
    from pftwin.model.scene import Scene


_UNKNOWN = "not known"  # standard deviation of a value that was set by a bound


@on_scene
def fit(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="FIT.json", help="File for the estimate.")],
    knee: FitOptions,
    method: Annotated[
        str, Option(metavar="NAME", help='A method: one of "Methods" at the top of this help.')
    ] = "least_squares",
    objective: Annotated[str, Option(metavar="NAME", help="Objective: likelihood or paper.")] = "likelihood",
    loss: Annotated[str, Option(metavar="NAME", help="Loss of residuals: linear, huber or soft_l1.")] = "linear",
    during: DuringOption = None,
    seed: Annotated[int, Option(min=0, help="Seed of all random choices.")] = 0,
    starts: Annotated[
        int | None, Option(min=1, help="Number of starting points (least_squares and gradient alone).")
    ] = None,
    checkpoint: Annotated[Path | None, Option(metavar="FILE", help="File for the state of the fit.")] = None,
    resume: Annotated[bool, Option("--resume", help="Continue from the checkpoint.")] = False,
    trained: Annotated[
        Path | None,
        Option(metavar="FILE.npz", help="Use a posterior from `pftwin train-posterior` instead of a new fit."),
    ] = None,
    calibrated: Annotated[
        Path | None,
        Option(metavar="FILE.json", help="Fit as `pftwin calibrate --method --widen` has: its settings and intervals."),
    ] = None,
    posterior: Annotated[
        int | None, Option(min=8, metavar="N", help="Check the intervals with N posterior draws in each of 4 chains.")
    ] = None,
    figures: Annotated[bool, Option("--figures/--no-figures", help="Write figures next to the output.")] = True,
    json: JsonOption = None,
) -> None:
    """Fit the tendons to motion capture of one or several trials, with standard deviations and intervals.

    Methods: `least_squares`, `gradient`, `genetic`, `matlab_ga`, `cma_es`, `differential_evolution`; or `simulations`,
    which computes the posterior from some 30,000 simulated recordings.

    Example: `pftwin fit --case 2 -o fit.json`, or `pftwin fit walk.toml stairs.toml -o fit.json`
    """
    check_suffix(output, [".json"], "estimates are JSON")
    check_outputs(output, checkpoint, json)
    limits, spans, trials = knee.limits(), time_spans(during), knee.load()
    asked: dict[str, Any] = {"method": method, "objective": objective, **knee.asked(trials[0].scene), "loss": loss}
    asked |= {"seed": seed} | ({} if starts is None else {"starts": starts})
    checkpointing: dict[str, Any] = {"checkpoint": checkpoint, "resume": resume}
    for path, trial in zip(knee.scene or [], trials, strict=False):
        if trial.scene.measured is None:
            raise InputError("nothing to compare with", where=path, expected="a table [measured] in the scene file")
    if trained is not None and calibrated is not None:
        raise InputError("both --trained and --calibrated", expected="one of them: each has its own settings")
    if posterior is not None:
        _check_posterior(objective, calibrated)
    scenes = [within(trial.scene, spans) for trial in trials]
    estimate = _estimated(scenes, limits, asked, checkpointing, trained, calibrated)
    interrupted = estimate.reason.startswith("interrupted")
    with report_written_on_interrupt(output, checkpoint):
        draws = None if interrupted else posterior
        _report(estimate, output, json, figures=figures and not interrupted, posterior=draws)
    if interrupted:
        raise Interrupted(output, checkpoint)
    if estimate.invalid:
        exit_flagged(estimate.sentence())


@on_scene
def plan_experiment(*, knee: ExperimentOptions, json: JsonOption = None) -> None:
    """Predict how precisely a planned experiment would determine the parameters, and what else to measure.

    With several scenes, the first is the recorded trial, and the others are possible further trials of the same knee.

    Example: `pftwin plan-experiment --case 2 --use position --noise position=2e-4`, or
    `pftwin plan-experiment walk.toml stairs.toml`
    """
    check_outputs(json)
    chosen, *further = knee.load()
    asked = knee.asked(chosen.scene)
    from fitting.identifiability import plan_experiment as plan
    from fitting.programs import channels_of

    if asked["use"] == "all":
        asked["use"] = channels_of(chosen.scene)
    with progress("linearising the motion") as shown:
        found = plan(chosen.scene, **asked, further=[each.scene for each in further], progress=progress_callback(shown))
    deviations = {", ".join(found.channels): found.relative, **{f"and {c}": v for c, v in found.additions.items()}}
    sheet = Sheet(
        f"{chosen.scene.name}: smallest possible standard deviations [%]",
        ("measured", *found.names),
        tuple((words, *(f"{100 * v:.3g}" for v in values)) for words, values in deviations.items()),
        words=(0,),
    )
    present({"scene": chosen.scene.name, **found.to_dict()}, sheet, found.sentence(), json=json)


@on_scene
def train_posterior(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.npz", help="File for the trained posterior.")],
    knee: FitOptions,
    simulations: Annotated[int | None, Option(min=1000, help="Number to train on; 30,000 if left out.")] = None,
    seed: Annotated[int, Option(min=0, help="Seed of all random choices.")] = 0,
    json: JsonOption = None,
) -> None:
    """Train a posterior once for a set-up; `pftwin fit --trained` then fits each of its recordings in seconds.

    Example: `pftwin train-posterior knee.toml --nuisance mri -o knee.npz`, then
    `pftwin fit walk2.toml --trained knee.npz -o fit.json`
    """
    check_suffix(output, [".npz"], "trained posteriors are files of NumPy's")
    check_outputs(output, json)
    limits, scenes = knee.limits(), [trial.scene for trial in knee.load()]
    asked = knee.asked(scenes[0])
    from fitting.training import train_posterior as train

    with progress("compiling") as shown:
        found = train(
            scenes,
            **asked,
            seed=seed,
            simulations=simulations,
            limits=limits,
            progress=lambda done, of: shown(done, of, what="simulations" if done < of else "networks"),
        )
    files = [str(found.save(output))]
    rows = tuple((name, f"{low:.6g} to {high:.6g}") for name, (low, high) in found.set_up.bounds.items())
    sheet = Sheet(f"{found.set_up.scene_name}: posterior from {found.simulations} simulations", ("", "bounds"), rows)
    present({**found.facts(), "files": files}, sheet, found.sentence(), written_line(files), json=json)


def _estimated(
    scenes: list[Scene],
    limits: dict[str, Any] | None,
    asked: dict[str, Any],
    checkpointing: dict[str, Any],
    trained: Path | None,
    calibrated: Path | None,
) -> Estimate:
    """The estimate by a trained posterior, by the settings of a calibrated fit, or by those that were asked for."""
    if trained is not None:
        from fitting.trained import TrainedPosterior

        refuse_settled(asked | checkpointing, "--trained")
        with spinner("answering"):
            return TrainedPosterior.load(trained, scenes).estimate(scenes, limits=limits)
    if calibrated is not None:
        from fitting.calibration.quick_fit import QuickFit

        refuse_settled(asked, "--calibrated")
        quick = QuickFit.load(calibrated)
        method, run = quick.method, partial(quick.estimate, scenes, limits=limits, **checkpointing)
    else:
        from fitting.fit import fit_tendons

        method, run = asked["method"], partial(fit_tendons, scenes, limits=limits, **asked, **checkpointing)
    with report_written_on_interrupt(checkpointing["checkpoint"]), progress(f"{method}: compiling") as shown:

        def tell(p: Progress) -> None:
            shown(p.iteration, p.of, f"{p.iteration}/{p.of}  best {p.best:.6g}  spread {p.spread:.2g}", method)

        return run(progress=tell)


def _report(estimate: Estimate, output: Path, json: str | None, *, figures: bool, posterior: int | None) -> None:
    """Writes and prints the estimate, its figures and, if `posterior` gives a number of draws, its posterior."""
    facts, summary, files = estimate.to_dict(), [], [str(estimate.save(output))]

    def draw(found: Estimate | Posterior) -> None:
        if figures:
            with spinner("drawing"):
                files.extend(str(p) for p in found.plot.save(output.with_suffix("")))

    draw(estimate)
    if posterior is not None:  # after the estimate is saved, because sampling takes long
        found = _sample_posterior(estimate, posterior, output)
        facts["posterior"] = found.to_dict()
        summary = [found.summary()]
        draw(found)
    e, against = estimate, "SYNTHETIC measurements" if estimate.synthetic else "measurements"
    rows = [
        (
            name,
            f"{value:.6g}\n{e.bound_mark(name)}".rstrip(),
            *((_UNKNOWN, _UNKNOWN) if name in e.set_by_bounds else (f"{sd:.2g}", f"{low:.6g} to {high:.6g}")),
            f"{nominal:.6g}",
            unit,
        )
        for name, value, sd, (low, high), nominal, unit in zip(
            e.names, e.values, e.standard_deviations, e.intervals, e.nominal, e.units, strict=True
        )
    ]
    title = f"{e.scene_name}, fitted to {against} ({e.method}, {e.objective})"
    head = ("", "estimate", "standard deviation", "95 % interval", "nominal", "unit")
    sheets = [Sheet(title, head, tuple(rows[: e.asked]), words=(0, 5))]
    short = tuple((name, value, sd, nominal, unit) for name, value, sd, _, nominal, unit in rows[e.asked : e.shared])
    if short:  # their long names leave no room for intervals
        sheets.append(Sheet("nuisance parameters", (*head[:3], *head[4:]), short, words=(0, 4)))
    if e.differences:
        each = ((n, of, both) for n, trials in e.in_trials.items() for of, both in trials.items())
        own = tuple((n, of, f"{value:.6g}", f"{sd:.2g}", e.units[e.names.index(n)]) for n, of, (value, sd) in each)
        sheets.append(Sheet("in each trial", ("", "trial", *head[1:3], "unit"), own, words=(0, 1, 4)))
    first = [e.sentence()] if e.invalid else []
    lines = [e.sentence(), *e.remarks(), f"stopped: {e.reason}", *summary, written_line(files)]
    present({**facts, "files": files}, *first, *sheets, *lines[len(first) :], json=json)


def _check_posterior(objective: str, calibrated: Path | None) -> None:
    """Raises before the fit if its posterior could not be sampled: no likelihood, intervals that a calibration
    widened, which the likelihood does not know, or blackjax is not installed."""
    from fitting.posterior.sampling import chain_runner

    if objective == "paper":
        raise InputError("the paper's objective is no likelihood", where="--posterior", remedy="--objective likelihood")
    if calibrated is not None:
        expected = "one of them: intervals that a calibration widened are wider than the likelihood's"
        raise InputError("--calibrated with --posterior", expected=expected)
    chain_runner()


def _sample_posterior(estimate: Estimate, draws: int, output: Path) -> Posterior:
    """Samples with progress on stderr, and adds the posterior to the estimate's file."""
    from fitting.posterior.sampling import sample_posterior
    from pftwin.base.text_files import write_json_file

    with progress("sampling the posterior") as shown:
        found = sample_posterior(estimate, draws=draws, seed=estimate.seed, progress=shown)
    write_json_file(output, {**estimate.to_dict(), "posterior": found.to_dict()})
    return found
