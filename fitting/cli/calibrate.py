"""`pftwin calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from fitting.cli.amounts import Given, show_limits, treatment_of, treatment_within, with_amounts
from fitting.cli.fit_options import FitOptions, deviations, names_in, refuse_settled
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import amount
from pftwin.cli.exit_codes import exit_flagged
from pftwin.cli.scenes import on_scene
from pftwin.cli.terminal import JsonOption, check_outputs, check_suffix, present, progress, spinner, written_line

if TYPE_CHECKING:
    from fitting.calibration.operations import Operation
    from fitting.calibration.plants import Maker
    from fitting.calibration.result import Calibration


@with_amounts("VALUE", "; with --meet, a range FROM:TO")
@on_scene
def calibrate(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="OUT.json", help="File for the calibration.")],
    knee: FitOptions,
    trained: Annotated[
        Path | None, Option(metavar="FILE.npz", help="A posterior that `pftwin train-posterior` trained.")
    ] = None,
    method: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="Calibrate this method of `pftwin fit` instead, which fits each plant anew. --free, --bounds, --use,"
            " --noise, --nuisance and --varies apply to it alone.",
        ),
    ] = None,
    plants: Annotated[int, Option(metavar="N", min=1, help="Number of plants of each kind.")] = 100,
    kinds: Annotated[
        str | None,
        Option(metavar="NAMES", help="Kinds; default: twin, misplaced, sliding, stiffening; also: reshaped."),
    ] = None,
    marker_noise: Annotated[
        str, Option(metavar="LENGTH", help="Standard deviation of each recorded marker coordinate [m].")
    ] = "0.2 mm",
    force_noise: Annotated[str, Option(metavar="FORCE", help="Standard deviation of load cells [N].")] = "0.15 N",
    reading_noise: Annotated[
        list[str] | None,
        Option(metavar="READING=SD", help="Standard deviation of another reading of the scene; may be repeated."),
    ] = None,
    cutoff: Annotated[float, Option(metavar="HERTZ", help="Low-pass cutoff for the markers; 0: no filter.")] = 12.0,
    amounts: Given,
    meet: Annotated[
        list[str] | None,
        Option(
            metavar="LIMIT",
            callback=show_limits,
            is_eager=True,
            help="Plan the smallest treatment that meets this limit, in the form of `optimise --limit`, and test it;"
            " may be repeated. help: lists the outcomes.",
        ),
    ] = None,
    samples: Annotated[int, Option(metavar="N", min=20, help="Draws from each estimate, for predictions.")] = 100,
    confidence: Annotated[
        float, Option(metavar="SHARE", help="Share of draws in which the limits of --meet must hold.")
    ] = 0.9,
    widen: Annotated[
        Path | None,
        Option(
            metavar="WIDER",
            help="Also write the posterior (.npz) or, with --method, the fit (.json, for `pftwin fit --calibrated`),"
            " with intervals widened to contain the true value in 95 % of these plants.",
        ),
    ] = None,
    seed: Annotated[int, Option(metavar="N", min=0, help="Seed of all random choices.")] = 0,
    figures: Annotated[bool, Option("--figures/--no-figures", help="Write figures next to the output.")] = True,
    json: JsonOption = None,
) -> None:
    """Measure how often intervals contain the true values, on simulated knees ("plants") that differ from the twin.

    With a treatment, also how often 90 % bands contain the outcomes of the treated plant; with `--meet`, how many
    planned treatments meet their limits on the plant.

    Example: `pftwin calibrate knee.toml --trained knee.npz --plants 100 --tto-medial 10 -o calibration.json`, or
    `pftwin calibrate walk.toml stairs.toml --method least_squares --plants 20 -o quick.json`
    """
    check_suffix(output, [".json"], "calibrations are JSON")
    if widen is not None and method is None:
        check_suffix(widen, [".npz"], "trained posteriors are files of NumPy's")
    elif widen is not None:
        check_suffix(widen, [".json"], "calibrated fits are JSON")
    errors = {
        "marker_noise": amount(marker_noise, "m", "--marker-noise", least=0),
        "force_noise": amount(force_noise, "N", "--force-noise", least=0),
    }
    check_outputs(output, widen, json)
    from fitting.calibration.calibrate import calibrate as run
    from fitting.calibration.laboratory import Laboratory
    from fitting.calibration.quick_fit import QuickFit
    from fitting.calibration.result import TO_WIDEN
    from fitting.trained import TrainedPosterior

    makers = _makers(kinds)
    lab = Laboratory(
        **errors,
        cutoff=cutoff or None,
        readings=deviations(reading_noise, "--reading-noise", "contact.force_medial=0.2") or {},
    )
    allowed, scenes = knee.limits(), [trial.scene for trial in knee.load()]
    asked = knee.asked(scenes[0])
    _check_what(trained, method, asked)
    if widen is not None and plants < TO_WIDEN:
        raise InputError(f"{plants} plants", where="--widen", expected=f"at least {TO_WIDEN} of each kind")
    operation = _operation(amounts, meet or [], samples, confidence)
    answering: TrainedPosterior | QuickFit
    if trained is not None:
        answering = TrainedPosterior.load(trained, scenes)
    else:
        answering = QuickFit.of(scenes, method=str(method), **asked)
    with progress("simulating plants") as shown:
        found = run(
            answering,
            scenes,
            plants=plants,
            kinds=makers,
            laboratory=lab,
            operation=operation,
            seed=seed,
            limits=allowed,
            progress=lambda kind, done, of: shown(done, of, what=f"plants {kind}"),
        )
    files, refusal = [str(found.save(output))], None
    if widen is not None:
        try:
            files.append(str(found.widened(answering).save(widen)))
        except InputError as error:  # raised once the calibration has been reported
            refusal = error
    if figures:
        with spinner("drawing"):
            files += [str(p) for p in found.plot.save(output.with_suffix(""))]
    parts = [*_sheets_of(found, answering.set_up.scene_name), found.sentence(), found.trained, written_line(files)]
    present({**found.to_dict(), "files": files}, *parts, json=json)
    if refusal is not None:
        raise refusal
    if not found.holds:
        exit_flagged(found.sentence())


def _makers(kinds: str | None) -> dict[str, Maker]:
    """Functions that make plants, by kind; InputError for an unknown kind."""
    from fitting.calibration.plants import BY_NAME, PLANTS

    known, chosen = PLANTS | BY_NAME, names_in(kinds) if kinds is not None else tuple(PLANTS)
    if not chosen or (strange := [kind for kind in chosen if kind not in known]):
        found = f"no plants {strange[0]!r}" if chosen else "none named"
        raise InputError(found, where="--kinds", expected=f"some of: {', '.join(known)}")
    return {kind: known[kind] for kind in chosen}


def _check_what(trained: Path | None, method: str | None, asked: dict[str, Any]) -> None:
    """Raises InputError unless exactly one of posterior and method is given, with options that apply to it."""
    if (trained is None) == (method is None):
        found = "neither --trained nor --method" if trained is None else "both --trained and --method"
        raise InputError(found, expected="exactly one of them: a trained posterior, or a method to run for each plant")
    if method is None:
        refuse_settled(asked, "--trained")


def _operation(amounts: Given, meet: list[str], samples: int, confidence: float) -> Operation | None:
    if not amounts and not meet:
        return None
    from fitting.calibration.operations import Operation
    from fitting.treatments.limits import Limit

    if not meet:
        return Operation(treatment_of(amounts), samples=samples)
    treatment, ranges = treatment_within(amounts)
    return Operation(treatment, tuple(Limit.parsed(text) for text in meet), ranges, samples, confidence)


def _sheets_of(found: Calibration, name: str) -> list[Sheet]:
    """Tables of coverage, with a column for each kind of plant."""
    head, said = ("SYNTHETIC plants", *found.kinds), found.operation
    sheets = [Sheet(f"{name}: coverage of 95 % intervals, mean half width", head, tuple(found.rows()), words=(0,))]
    if found.predictions:
        title = f"coverage of 90 % bands, mean half width, after {said}"
        sheets.append(Sheet(title, head, tuple(found.prediction_rows()), words=(0,)))
    if found.plans:
        sheets.append(Sheet(f"plans: {said}", head, tuple(found.plan_rows()), words=(0,)))
    return sheets
