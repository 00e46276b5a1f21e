"""`pftwin treat`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, working, write_json
from pftwin.errors import InputError, OutputError

if TYPE_CHECKING:
    from rich.table import Table
    from xarray import Dataset

    from fitting.treatments import Treatment

_VIRTUAL = "the rig is virtual: its recorded motion is synthetic"
_MOST_ROWS = 40
_MOST_VARIANTS = 1_000_000


def _amount(flag: str, what: str, unit: str = "mm") -> Any:
    return typer.Option(flag, metavar="FROM:TO:STEP", help=f"{what} [{unit}]; or values: 0,5,10.")


def treat(
    scene: SceneArgument = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.nc", help="The outcomes as NetCDF.")],
    case: CaseOption = None,
    contact: ContactOption = None,
    estimate: Annotated[
        Path | None, typer.Option("--estimate", metavar="FIT.json", help="Parameters that `pftwin fit` found.")
    ] = None,
    medialise: Annotated[str | None, _amount("--medialise", "Tibial tuberosity medially")] = None,
    anteriorise: Annotated[str | None, _amount("--anteriorise", "Tibial tuberosity anteriorly")] = None,
    distalise: Annotated[str | None, _amount("--distalise", "Tibial tuberosity distally")] = None,
    lengthen_tendon: Annotated[str | None, _amount("--lengthen-tendon", "Patellar tendon longer")] = None,
    lengthen_quadriceps: Annotated[str | None, _amount("--lengthen-quadriceps", "Quadriceps tendon longer")] = None,
    deepen: Annotated[str | None, _amount("--deepen", "Trochleoplasty: groove deeper")] = None,
    rotate_component: Annotated[
        str | None, _amount("--rotate-component", "Femoral component turned externally", "deg")
    ] = None,
    medialise_component: Annotated[str | None, _amount("--medialise-component", "Femoral component medially")] = None,
    medialise_button: Annotated[str | None, _amount("--medialise-button", "Button medially")] = None,
    release: Annotated[str | None, _amount("--release", "Lateral strands released", "%")] = None,
    tighten_mpfl: Annotated[str | None, _amount("--tighten-mpfl", "MPFL graft shorter")] = None,
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
    given = {
        "tibial_tuberosity_transfer": {
            "medialisation": ("--medialise", medialise),
            "anteriorisation": ("--anteriorise", anteriorise),
            "distalisation": ("--distalise", distalise),
        },
        "patellar_tendon_length_change": {"lengthening": ("--lengthen-tendon", lengthen_tendon)},
        "quadriceps_lengthening": {"lengthening": ("--lengthen-quadriceps", lengthen_quadriceps)},
        "trochleoplasty": {"deepening": ("--deepen", deepen)},
        "femoral_component_rotation": {"external_rotation": ("--rotate-component", rotate_component)},
        "femoral_component_translation": {"medialisation": ("--medialise-component", medialise_component)},
        "button_position": {"medialisation": ("--medialise-button", medialise_button)},
        "lateral_release": {"release": ("--release", release)},
        "mpfl_graft": {"shortening": ("--tighten-mpfl", tighten_mpfl)},
    }
    wanted = {k: {n: (o, t) for n, (o, t) in v.items() if t is not None} for k, v in given.items()}
    wanted = {k: v for k, v in wanted.items() if v}
    if not wanted:
        raise InputError("no treatment given", expected="at least one amount", remedy="--medialise 0:20:1")
    if output.suffix.lower() != ".nc":
        raise OutputError(f"{output}: results are NetCDF; try: {output.with_suffix('.nc')}")
    values = {k: {n: (o, _values(t, o)) for n, (o, t) in v.items()} for k, v in wanted.items()}
    pictures = [output.with_suffix(s) for s in (".png", ".svg")] if figure else []
    check_outputs(output, *pictures, json)
    start_computing()
    variants = _variants(values)
    found = None if estimate is None else _estimate(estimate)
    chosen = chosen_scene(scene, case, contact)
    from fitting.predict import predict
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
    if case is not None:
        data.attrs["note"] = "; ".join([_VIRTUAL, *([data.attrs["note"]] if "note" in data.attrs else [])])
    with working("writing"):
        save_dataset(data, output)
        written = [output, *(_draw(data, output, chosen.scene.name) if figure and data.sizes["variant"] > 1 else [])]
    write_json({**_facts(data), "finding": _finding(data), "files": [str(p) for p in written]}, json)
    console = out(json)
    console.print(_table(data))
    for line in (_finding(data), data.attrs.get("note", ""), f"written: {', '.join(str(p) for p in written)}"):
        if line:
            console.print(line, markup=False, highlight=False)


def _values(text: str, option: str) -> list[float]:
    """Numbers from "0:20:1" (the end included), "0,5,10" or "7"."""
    import math

    try:
        parts = [float(p) for p in text.split(":" if ":" in text else ",")]
    except ValueError:
        parts = []
    if not parts or not all(map(math.isfinite, parts)) or (":" in text and len(parts) not in (2, 3)):
        raise InputError(f"found {text!r}", where=option, expected="FROM:TO:STEP, or values such as 0,5,10")
    if ":" not in text:
        return parts
    first, last = parts[:2]
    step = parts[2] if len(parts) == 3 else 1.0
    if step == 0 or (last - first) * step < 0:
        raise InputError(f"found {text!r}", where=option, expected="a step that leads from the first to the last value")
    count = math.floor((last - first) / step + 1e-9) + 1
    if count > _MOST_VARIANTS:
        raise InputError(f"{count} values", where=option, expected=f"at most {_MOST_VARIANTS}")
    return [first + i * step for i in range(count)]


def _variants(values: dict[str, dict[str, tuple[str, list[float]]]]) -> Treatment:
    """All combinations."""
    import math

    from fitting.treatments import KINDS, Treatment
    from fitting.variants import grid

    count = math.prod(len(v) for amounts in values.values() for _, v in amounts.values())
    if count > _MOST_VARIANTS:
        raise InputError(f"{count} combinations", expected=f"at most {_MOST_VARIANTS}", remedy="longer steps")
    whole, axes = Treatment(), {}
    for kind, amounts in values.items():
        whole = whole.then(Treatment.of(kind, dict.fromkeys(amounts, 0.0)))
        for name, (_, shown) in amounts.items():
            axes[f"{kind}.{name}"] = KINDS[kind].amounts[name].from_shown(shown)
    return grid(whole, axes)


def _estimate(path: Path) -> Any:
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
