"""`pftwin treat`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.cli.amounts import Given, by_kind, values, with_amounts
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, working, write_json
from pftwin.errors import InputError, OutputError
from pftwin.labels import SYNTHETIC

if TYPE_CHECKING:
    from rich.table import Table
    from xarray import Dataset

    from fitting.estimate import Estimate
    from fitting.treatments import Treatment

_MOST_ROWS = 40
_MOST_VARIANTS = 1_000_000

EstimateOption = Annotated[
    Path | None, typer.Option("--estimate", metavar="FIT.json", help="Parameters that `pftwin fit` found.")
]


@with_amounts("FROM:TO:STEP", "; or values: 0,5,10")
def treat(
    scene: SceneArgument = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.nc", help="The outcomes as NetCDF.")],
    case: CaseOption = None,
    contact: ContactOption = None,
    estimate: EstimateOption = None,
    amounts: Given,
    samples: Annotated[
        int, typer.Option("--samples", min=0, help="Draws from the estimate's uncertainty, for bands.")
    ] = 50,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 0,
    dt: Annotated[float, typer.Option("--dt", metavar="SECONDS", help="Longest time step [s].")] = 2.5e-3,
    figure: Annotated[bool, typer.Option(help="Also figures, beside it: OUT.png and OUT.svg.")] = True,
    json: JsonOption = None,
) -> None:
    """Predict what treatments would do: all combinations of the amounts given, with bands from a fit's uncertainty.

    Example: `pftwin treat --case 2 --estimate fit.json --medialise 0:20:1 -o variants.nc`
    """
    wanted = by_kind(amounts)
    if output.suffix.lower() != ".nc":
        raise OutputError(f"{output}: results are NetCDF; try: {output.with_suffix('.nc')}")
    numbers = {k: {a.name: values(text, a.flag) for a, text in v} for k, v in wanted.items()}
    pictures = [output.with_suffix(s) for s in (".png", ".svg")] if figure else []
    check_outputs(output, *pictures, json)
    start_computing()
    variants = _variants(numbers)
    found = None if estimate is None else loaded_estimate(estimate)
    chosen = chosen_scene(scene, case, contact)
    from fitting.predicting import predict
    from pftwin.result_files import save_dataset

    with err().status("compiling and simulating ...") as spinner:
        data = predict(
            chosen.scene,
            variants,
            found,
            samples=samples if found is not None else 0,
            seed=seed,
            dt=dt,
            progress=lambda done, of: spinner.update(f"simulated {done} of {of} variants and draws ..."),
        )
    if chosen.scene.synthetic:
        data.attrs["note"] = "; ".join([SYNTHETIC, *([data.attrs["note"]] if "note" in data.attrs else [])])
    with working("writing"):
        save_dataset(data, output)
        written = [output, *(_draw(data, output, chosen.scene.name) if figure and data.sizes["variant"] > 1 else [])]
    write_json({**_facts(data), "finding": _finding(data), "files": [str(p) for p in written]}, json)
    console = out(json)
    console.print(_table(data))
    for line in (_finding(data), data.attrs.get("note", ""), f"written: {', '.join(str(p) for p in written)}"):
        if line:
            console.print(line, markup=False, highlight=False)


def _variants(numbers: dict[str, dict[str, list[float]]]) -> Treatment:
    """All combinations."""
    import math

    from fitting.treatments import KINDS, Treatment
    from fitting.variants import grid

    count = math.prod(len(v) for amounts in numbers.values() for v in amounts.values())
    if count > _MOST_VARIANTS:
        raise InputError(f"{count} combinations", expected=f"at most {_MOST_VARIANTS}", remedy="longer steps")
    whole, axes = Treatment(), {}
    for kind, amounts in numbers.items():
        whole = whole.then(Treatment.of(kind, dict.fromkeys(amounts, 0.0)))
        for name, shown in amounts.items():
            axes[f"{kind}.{name}"] = KINDS[kind].amounts[name].from_shown(shown)
    return grid(whole, axes)


def loaded_estimate(path: Path) -> Estimate:
    """An estimate that `pftwin fit` wrote."""
    from fitting.estimate import Estimate

    return Estimate.load(path)


def _draw(data: Dataset, output: Path, name: str) -> list[Path]:
    from fitting.prediction_plots import outcome_figure
    from pftwin.plots import save_figure

    return list(save_figure(outcome_figure(data, f"{name}: predicted outcomes"), output.with_suffix("")))


def _finding(data: Dataset) -> str:
    from fitting.prediction_table import finding

    return finding(data)


def _facts(data: Dataset) -> dict[str, Any]:
    from fitting.prediction_table import facts

    return facts(data)


def _table(data: Dataset) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from fitting.prediction_table import rows

    headings, lines = rows(data)
    left_out = len(lines) - _MOST_ROWS
    title = data.attrs["title"] + (f" ({left_out} of {len(lines)} variants not shown)" if left_out > 0 else "")
    table = Table(title=escape(title))
    for heading in headings:
        table.add_column(escape(heading), justify="right")
    for line in lines[:_MOST_ROWS]:
        table.add_row(*(escape(cell) for cell in line))
    return table
