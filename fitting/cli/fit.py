"""`pftwin fit`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fitting.cli.posterior import check_posterior, with_posterior
from pftwin.base.errors import InputError, OutputError
from pftwin.cli.exit_codes import Interrupted, keeping
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from fitting.estimate import Estimate
    from fitting.fit import Progress

FreeOption = Annotated[
    str, typer.Option("--free", metavar="NAMES", help='Parameters, with commas: "K1,L1,contact.radius".')
]
BoundsOption = Annotated[
    float, typer.Option("--bounds", metavar="SHARE", help="To either side, as a share of the nominal value.")
]
UseOption = Annotated[
    str,
    typer.Option("--use", metavar="CHANNELS", help="What is compared: position, orientation, effects' forces; or all."),
]
NoiseOption = Annotated[
    list[str] | None,
    typer.Option("--noise", metavar="CHANNEL=SD", help="Standard deviation in m, rad or N; may be repeated."),
]


def fit(
    scene: SceneArgument = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FIT.json", help="The estimate.")],
    case: CaseOption = None,
    contact: ContactOption = None,
    method: Annotated[
        str,
        typer.Option(metavar="NAME", help="least_squares, gradient, genetic, cma_es or differential_evolution."),
    ] = "least_squares",
    objective: Annotated[str, typer.Option(metavar="NAME", help="likelihood or paper.")] = "likelihood",
    free: FreeOption = "K1,L1,K2,L2",
    bounds: BoundsOption = 0.3,
    use: UseOption = "position",
    noise: NoiseOption = None,
    loss: Annotated[str, typer.Option(metavar="NAME", help="linear, huber or soft_l1.")] = "linear",
    seed: Annotated[int, typer.Option(min=0, help="Of all random choices.")] = 0,
    starts: Annotated[int | None, typer.Option(min=1, help="Starting points (least squares, gradient).")] = None,
    checkpoint: Annotated[Path | None, typer.Option(metavar="FILE", help="Where the state of the fit is kept.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    posterior: Annotated[
        int | None,
        typer.Option(min=8, metavar="N", help="Check the intervals by N draws from the posterior in each of 4 chains."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Figures beside the output.")] = True,
    json: JsonOption = None,
) -> None:
    """Fit the tendons to motion capture, and say how sure the answer is.

    Example: `pftwin fit --case 2 -o fit.json`
    """
    if output.suffix.lower() != ".json":
        raise OutputError(f"{output}: estimates are JSON; try: {output.with_suffix('.json')}")
    check_outputs(output, checkpoint, json)
    levels = noise_levels(noise)
    chosen = chosen_scene(scene, case, contact)
    if chosen.measured is None:
        raise InputError("nothing to compare with", where=scene, expected="a table [measured] in the scene file")
    from fitting.fit import fit_tendons

    if posterior is not None:
        check_posterior(objective)
    options: dict[str, Any] = {} if starts is None else {"starts": starts}
    with keeping(checkpoint), _shown(method) as progress:
        estimate = fit_tendons(
            chosen.scene,
            chosen.measured,
            method=method,
            objective=objective,
            free=names_in(free),
            bounds=bounds,
            seed=seed,
            use="all" if use.strip() == "all" else names_in(use),
            noise=levels,
            loss=loss,
            progress=progress,
            checkpoint=checkpoint,
            resume=resume,
            **options,
        )
    interrupted = estimate.reason.startswith("interrupted")
    with keeping(output, checkpoint):
        draws = None if interrupted else posterior
        _report(estimate, output, json, figures=figures and not interrupted, posterior=draws)
    if interrupted:
        raise Interrupted(output, *([] if checkpoint is None else [checkpoint]))


def _report(estimate: Estimate, output: Path, json: str | None, *, figures: bool, posterior: int | None) -> None:
    """Writes the estimate, its figures and, where it is wanted, its posterior; says what was found."""
    written = [str(estimate.save(output))]
    if figures:
        with working("drawing"):
            written += [str(p) for p in estimate.plot.save(output.with_suffix(""))]
    facts, said = estimate.to_dict(), []
    if posterior is not None:  # the estimate is on disk already
        found = with_posterior(estimate, posterior, estimate.seed, output)
        facts["posterior"] = found.to_dict()
        said = ["", found.summary()]
        if figures:
            with working("drawing"):
                written += [str(p) for p in found.plot.save(output.with_suffix(""))]
    write_json({**facts, "files": written}, json)
    console = out(json)
    console.print(_table(estimate))
    for line in (estimate.sentence(), *estimate.remarks(), f"stopped: {estimate.reason}", *said):
        console.print(line, markup=False, highlight=False)
    console.print(f"written: {', '.join(written)}", markup=False, highlight=False)


def names_in(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def noise_levels(given: list[str] | None) -> dict[str, float] | None:
    """From "channel=sd".

    Raises:
        InputError: anything else.
    """
    levels = {}
    for text in given or []:
        channel, _, value = text.partition("=")
        try:
            levels[channel.strip()] = float(value)
        except ValueError:
            raise InputError(f"found {text!r}", where="--noise", expected='such as "position=2e-4"') from None
    return levels or None


@contextmanager
def _shown(method: str) -> Iterator[Callable[[Progress], None]]:
    """Iteration, best, spread and time left on stderr."""
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[now]}"), TimeRemainingColumn())
    with Bar(*columns, console=err(), transient=True) as bar:
        task = bar.add_task(f"{method}: compiling", total=None, now="")

        def show(p: Progress) -> None:
            now = f"{p.iteration}/{p.of}  best {p.best:.6g}  spread {p.spread:.2g}"
            bar.update(task, description=method, total=p.of, completed=p.iteration, now=now)

        yield show


def _table(estimate: Estimate) -> Table:
    """Value, standard deviation and interval of every parameter."""
    from rich.markup import escape
    from rich.table import Table

    against = "SYNTHETIC measurements" if estimate.synthetic else "measurements"
    table = Table(title=escape(f"{estimate.scene_name}, fitted to {against} ({estimate.method}, {estimate.objective})"))
    table.add_column("", no_wrap=True)
    for name in ("estimate", "standard deviation", "95 % interval", "nominal"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    rows = zip(
        estimate.names,
        estimate.values,
        estimate.standard_deviations,
        estimate.intervals,
        estimate.nominal,
        estimate.units,
        strict=True,
    )
    for name, value, sd, (low, high), nominal, unit in rows:
        table.add_row(escape(name), f"{value:.6g}", f"{sd:.2g}", f"{low:.6g} to {high:.6g}", f"{nominal:.6g}", unit)
    return table
