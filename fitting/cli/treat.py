"""`pftwin treat`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fitting.cli.amounts import Given, by_kind, values, with_amounts
from pftwin.base.errors import InputError, OutputError
from pftwin.cli.exit_codes import Interrupted, flagged
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, working, write_json

if TYPE_CHECKING:
    from rich.table import Table
    from xarray import Dataset

    from fitting.estimate import Estimate
    from fitting.treatments import Treatment
    from pftwin.model.scene import Scene

_MOST_ROWS = 40
_MOST_VARIANTS = 1_000_000
_BLOCK = 4096  # members that are simulated in one go: what Ctrl-C can lose

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
    start_computing(batches=True)
    variants = _variants(numbers)
    found = None if estimate is None else loaded_estimate(estimate)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.files.result_files import save_dataset

    draws = samples if found is not None else 0
    data, whole = _predicted(chosen.scene, variants, found, samples=draws, seed=seed, dt=dt)
    with working("writing"):
        save_dataset(data, output)
        if not whole:
            raise Interrupted(output)
        written = [output, *(_draw(data, output, chosen.scene.name) if figure and data.sizes["variant"] > 1 else [])]
    write_json({**_facts(data), "finding": _finding(data), "files": [str(p) for p in written]}, json)
    console = out(json)
    console.print(_table(data))
    for line in (_finding(data), data.attrs.get("note", ""), f"written: {', '.join(str(p) for p in written)}"):
        if line:
            console.print(line, markup=False, highlight=False)
    own = data["failed"].isel(sample=0) if "sample" in data.dims else data["failed"]
    if failed := int(own.sum()):
        flagged(f"{failed} of {data.sizes['variant']} variants could not be simulated")


def _predicted(scene: Scene, variants: Treatment, estimate: Estimate | None, **options: Any) -> tuple[Dataset, bool]:
    """Outcomes, block by block of variants, and whether they are all there: after Ctrl-C, those of the blocks done."""
    from fitting.prediction.predicting import predict
    from fitting.prediction.variants import amounts_of

    amounts = amounts_of(variants)
    draws = 1 + options["samples"]
    size, count = max(1, _BLOCK // draws), len(amounts)
    blocks: list[Dataset] = []
    with err().status("compiling and simulating ...") as spinner:
        try:
            for first in range(0, count, size):
                rows = variants.with_values(amounts[first : first + size].T)

                def told(done: int, _: int, before: int = first * draws) -> None:
                    spinner.update(f"simulated {before + done} of {count * draws} variants and draws ...")

                blocks.append(predict(scene, rows, estimate, progress=told, **options))
        except KeyboardInterrupt:
            if not blocks:
                raise
    return _together(blocks, count), len(blocks) == -(-count // size)


def _together(blocks: list[Dataset], count: int) -> Dataset:
    """One dataset of blocks of variants; says so where some are missing."""
    import numpy as np
    import xarray

    data = blocks[0]
    if len(blocks) > 1:
        data = xarray.concat(
            blocks, "variant", data_vars="minimal", coords="minimal", compat="override", join="override"
        )
        about = blocks[0]["variant"].attrs
        data = data.assign_coords(variant=("variant", np.arange(data.sizes["variant"]), about))
    if (there := data.sizes["variant"]) < count:
        data.attrs["title"] += f" (interrupted: {there} of {count} variants)"
        data.attrs["variants_missing"] = count - there
    return data


def _variants(numbers: dict[str, dict[str, list[float]]]) -> Treatment:
    """All combinations."""
    import math

    from fitting.prediction.variants import combinations

    count = math.prod(len(v) for amounts in numbers.values() for v in amounts.values())
    if count > _MOST_VARIANTS:
        raise InputError(f"{count} combinations", expected=f"at most {_MOST_VARIANTS}", remedy="longer steps")
    return combinations(numbers)


def loaded_estimate(path: Path) -> Estimate:
    """An estimate that `pftwin fit` wrote."""
    from fitting.estimate import Estimate

    return Estimate.load(path)


def _draw(data: Dataset, output: Path, name: str) -> list[Path]:
    from fitting.prediction.plots import outcome_figure
    from pftwin.results.plots import save_figure

    return list(save_figure(outcome_figure(data, f"{name}: predicted outcomes"), output.with_suffix("")))


def _finding(data: Dataset) -> str:
    from fitting.prediction.plots import finding

    return finding(data)


def _facts(data: Dataset) -> dict[str, Any]:
    from fitting.prediction.plots import facts

    return facts(data)


def _table(data: Dataset) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from fitting.prediction.plots import rows

    headings, lines = rows(data)
    left_out = len(lines) - _MOST_ROWS
    title = data.attrs["title"] + (f" ({left_out} of {len(lines)} variants not shown)" if left_out > 0 else "")
    table = Table(title=escape(title))
    for heading in headings:
        table.add_column(escape(heading), justify="right")
    for line in lines[:_MOST_ROWS]:
        table.add_row(*(escape(cell) for cell in line))
    return table
