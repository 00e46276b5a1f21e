"""`pftwin treat` and `pftwin optimise`."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from fitting.cli.amounts import Given, by_kind, show_limits, treatment_within, with_amounts
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import several_amounts
from pftwin.cli import terminal
from pftwin.cli.exit_codes import Interrupted, exit_flagged
from pftwin.cli.scenes import SceneOptions, on_scene, seconds

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate
    from fitting.treatments import Treatment
    from fitting.treatments.limits import TreatmentPlan
    from pftwin.model.scene import Scene

_MOST_ROWS = 40
_MOST_VARIANTS = 1_000_000
_BLOCK = 4096  # simulations per block; Ctrl-C loses the current block

EstimateOption = Annotated[
    Path | None, Option("--estimate", metavar="FIT.json", help="Estimate from `pftwin fit`; by default none.")
]
StepOption = Annotated[
    float | None,
    Option(
        "--dt",
        metavar="SECONDS",
        parser=seconds,
        help='Longest time step [s], or "0.5 ms". If left out: 0.0005, shorter where accuracy requires it.',
    ),
]
LimitOption = Annotated[
    list[str],
    Option(
        metavar="LIMIT",
        callback=show_limits,
        is_eager=True,
        help="A limit to meet: an outcome, <= or >=, a number and its unit; may be repeated. help: lists the outcomes.",
    ),
]
SeedOption = Annotated[int, Option("--seed", metavar="N", min=0, help="Seed of the draws.")]


@with_amounts("FROM:TO:STEP", "; or values such as 0,5,10")
@on_scene
def treat(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="OUT.nc", help="NetCDF file for the outcomes.")],
    knee: SceneOptions,
    estimate: EstimateOption = None,
    amounts: Given,
    samples: Annotated[int, Option(metavar="N", min=0, help="Draws from the estimate's uncertainty, for bands.")] = 50,
    seed: SeedOption = 0,
    dt: StepOption = None,
    figure: Annotated[bool, Option(help="Also write figures OUT.png and OUT.svg.")] = True,
    json: terminal.JsonOption = None,
) -> None:
    """Predict outcomes of treatments, for all combinations of the given amounts, with bands from a fit's uncertainty.

    Amounts may have a unit: "16 mm", "0:2:0.5 cm".

    Example: `pftwin treat --case 2 --estimate fit.json --tto-medial 0:20:1 -o variants.nc`
    """
    numbers = by_kind([(a, several_amounts(text, a.flag, a.unit)) for a, text in amounts])
    terminal.check_suffix(output, [".nc"], "results are NetCDF")
    pictures = [output.with_suffix(s) for s in (".png", ".svg")] if figure else []
    terminal.check_outputs(output, *pictures, json)
    terminal.start_computing(batches=True)
    from fitting.prediction.variants import combinations

    if (count := prod(len(v) for own in numbers.values() for v in own.values())) > _MOST_VARIANTS:
        raise InputError(f"{count} combinations", expected=f"at most {_MOST_VARIANTS}", remedy="longer steps")
    variants = combinations(numbers)
    found = loaded_estimate(estimate)
    chosen = knee.load()
    from fitting.prediction import plots
    from fitting.prediction.band_sources import band_sources
    from pftwin.files.result_files import save_dataset
    from pftwin.results.plots import save_figure

    draws = samples if found is not None else 0
    data, whole = _predicted(chosen.scene, variants, found, samples=draws, seed=seed, dt=dt)
    with terminal.spinner("writing"):
        save_dataset(data, output)
        if not whole:
            raise Interrupted(output)
        files = [output]
        if figure and data.sizes["variant"] > 1:
            drawn = plots.outcome_figure(data, f"{chosen.scene.name}: predicted outcomes")
            files += save_figure(drawn, output.with_suffix(""))
    invalid, finding = data.attrs.get("objection"), plots.main_finding(data)
    outcome = {**plots.facts(data), "finding": finding, "files": [str(p) for p in files]}
    doubt = plots.invalid_variants(data) or plots.narrow_bands(data)
    sheet = plots.outcome_sheet(data, _MOST_ROWS)
    parts = (finding, sheet) if doubt or invalid else (sheet, finding)
    if "parameter_kind" in data.coords and "sample" in data.dims:
        sources = band_sources(data)
        outcome["bands_narrower_if_known"] = sources.facts()
        parts += (sources.sheet(),)
    terminal.present(outcome, *parts, data.attrs.get("note", ""), terminal.written_line(files), json=json)
    if why := doubt or invalid:
        exit_flagged(why)


@with_amounts("FROM:TO", ", within this range")
@on_scene
def optimise(
    *,
    limit: LimitOption,
    output: Annotated[Path | None, Option("-o", "--output", metavar="PLAN.json", help="File for the plan.")] = None,
    knee: SceneOptions,
    estimate: EstimateOption = None,
    amounts: Given,
    samples: Annotated[
        int | None,
        Option(metavar="N", min=0, help="Draws from the estimate's uncertainty; default: 50 with --estimate, else 0."),
    ] = None,
    confidence: Annotated[float, Option(metavar="SHARE", help="Share of the draws that must meet all limits.")] = 0.9,
    seed: SeedOption = 0,
    dt: StepOption = None,
    json: terminal.JsonOption = None,
) -> None:
    """Find the smallest treatment that meets stated limits, and the share of an estimate's draws in which it does.

    Amounts may have a unit: "0:2 cm". `--limit help` lists the outcomes that take a limit.

    Example: `pftwin optimise --case 2 --estimate fit.json --limit "dislocation_margin>=3 mm" --tto-medial 0:20 -o
    plan.json`
    """
    terminal.check_outputs(output, json)
    terminal.start_computing(batches=True)
    treatment, ranges = treatment_within(amounts)
    from fitting.prediction.predicting import caveats
    from fitting.treatments.limits import Limit
    from fitting.treatments.optimise import optimise_treatment

    stated = [Limit.parsed(text) for text in limit]
    found = loaded_estimate(estimate)
    chosen = knee.load()
    with terminal.progress("searching") as shown:
        plan = optimise_treatment(
            chosen.scene,
            stated,
            ranges,
            treatment,
            found,
            samples=(0 if found is None else 50) if samples is None else samples,
            confidence=confidence,
            seed=seed,
            dt=dt,
            progress=terminal.progress_callback(shown),
        )
    notes = caveats(found, chosen.scene.synthetic)
    facts = {"scene": chosen.scene.name, **plan.to_dict(), "notes": notes}
    files = [] if output is None else [output]
    for path in files:
        terminal.write_json(facts, str(path))
    parts = (plan.describe(),) if plan.invalid else (_sheet_of(plan, chosen.scene.name), plan.describe())
    terminal.present(facts, *parts, *notes, terminal.written_line(files), json=json)
    if plan.interrupted:
        raise Interrupted(output, json)
    if plan.invalid:
        exit_flagged(plan.invalid)
    if not plan.met:
        exit_flagged("no amount within the range meets the limits")


def _sheet_of(plan: TreatmentPlan, name: str) -> Sheet:
    """A plan's limits, with the values of a scene `name` that is treated so."""
    from fitting.treatments.limits import in_units

    reached = [(lim, plan.outcomes[lim.outcome]) for lim in plan.limits]
    rows = ((lim.describe(), in_units(lim.outcome, v), "yes" if lim.room(v) >= 0 else "no") for lim, v in reached)
    return Sheet(f"{name}: {plan.treatment.describe()}", ("limit", "value", "met"), tuple(rows))


def _predicted(scene: Scene, variants: Treatment, estimate: Estimate | None, **options: Any) -> tuple[Dataset, bool]:
    """Predicts outcomes in blocks of variants; returns them, and whether all finished: Ctrl-C keeps finished blocks."""
    from fitting.prediction.predicting import predict
    from fitting.prediction.variants import amounts_of

    amounts = amounts_of(variants)
    draws = 1 + options["samples"]
    size, count = max(1, _BLOCK // draws), len(amounts)
    blocks: list[Dataset] = []
    with terminal.progress("compiling and simulating") as shown:
        try:
            for first in range(0, count, size):
                rows = variants.with_values(amounts[first : first + size].T)

                def report(done: int, _: int, before: int = first * draws) -> None:
                    shown(before + done, count * draws, f"{before + done} of {count * draws} variants and draws")

                blocks.append(predict(scene, rows, estimate, progress=report, **options))
        except KeyboardInterrupt:
            if not blocks:
                raise
    return _joined_blocks(blocks, count), len(blocks) == -(-count // size)


def _joined_blocks(blocks: list[Dataset], count: int) -> Dataset:
    """Joins blocks of variants into one dataset; its title states how many of `count` are missing."""
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


def loaded_estimate(path: Path | None) -> Estimate | None:
    """Loads an estimate that `pftwin fit` wrote; None without a path."""
    from fitting.estimate import Estimate

    return None if path is None else Estimate.load(path)
