"""`pftwin optimise`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fitting.cli.amounts import Given, by_kind, limits, with_amounts
from fitting.cli.treat import EstimateOption, loaded_estimate
from pftwin.cli.exit_codes import flagged
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, out, start_computing, working, write_json
from pftwin.model.measured import SYNTHETIC

if TYPE_CHECKING:
    from rich.table import Table

    from fitting.treatments import Treatment
    from fitting.treatments.limits import TreatmentPlan


@with_amounts("FROM:TO", ", within these limits")
def optimise(
    scene: SceneArgument = None,
    *,
    limit: Annotated[
        list[str],
        typer.Option("--limit", metavar="LIMIT", help='To be met: "dislocation_margin>=3 mm"; may be repeated.'),
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="PLAN.json", help="The plan.")] = None,
    case: CaseOption = None,
    contact: ContactOption = None,
    estimate: EstimateOption = None,
    amounts: Given,
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=0, help="Draws from the estimate's uncertainty; 50 where there is one."),
    ] = None,
    confidence: Annotated[
        float, typer.Option("--confidence", metavar="SHARE", help="Share of the draws in which all limits must hold.")
    ] = 0.9,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the draws.")] = 0,
    dt: Annotated[float, typer.Option("--dt", metavar="SECONDS", help="Longest time step [s].")] = 2.5e-3,
    json: JsonOption = None,
) -> None:
    """Find the smallest treatment that meets stated limits, and say how surely it does.

    Example: `pftwin optimise --case 2 --estimate fit.json --limit "dislocation_margin>=3 mm" --medialise 0:20 -o
    plan.json`
    """
    wanted = by_kind(amounts)
    pairs = {f"{k}.{a.name}": limits(text, a.flag) for k, given in wanted.items() for a, text in given}
    check_outputs(output, json)
    start_computing(batches=True)
    from fitting.treatments.limits import Limit
    from fitting.treatments.optimise import optimise_treatment

    stated = [Limit.parsed(text) for text in limit]
    found = None if estimate is None else loaded_estimate(estimate)
    chosen = chosen_scene(scene, case, contact)
    treatment, ranges = _treatment(pairs)
    with working("searching"):
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
        )
    notes = _notes(chosen.scene.synthetic, found)
    facts = {"scene": chosen.scene.name, **plan.to_dict(), "notes": notes}
    for place in (None if output is None else str(output), json):
        write_json(facts, place)
    out(json).print(_table(plan, chosen.scene.name))
    for line in (plan.describe(), *notes, *([] if output is None else [f"written: {output}"])):
        out(json).print(line, markup=False, highlight=False)
    if not plan.met:
        flagged("no amount within the range meets the limits")


def _treatment(pairs: dict[str, tuple[float, float]]) -> tuple[Treatment, dict[str, tuple[float, float]]]:
    """A treatment that has these amounts, and their ranges in SI units."""
    from fitting.treatments import KINDS, Treatment

    whole, ranges = Treatment(), {}
    kinds = dict.fromkeys(name.partition(".")[0] for name in pairs)
    for kind in kinds:
        own = {n.partition(".")[2]: v for n, v in pairs.items() if n.partition(".")[0] == kind}
        whole = whole.then(Treatment.of(kind, dict.fromkeys(own, 0.0)))
        for name, pair in own.items():
            low, high = KINDS[kind].amounts[name].from_shown(pair)
            ranges[f"{kind}.{name}"] = (float(low), float(high))
    return whole, ranges


def _notes(synthetic: bool, estimate: Any) -> list[str]:
    said = [SYNTHETIC] if synthetic else []
    if estimate is not None and estimate.synthetic:
        said.append("the parameters were estimated from synthetic measurements")
    return said


def _table(plan: TreatmentPlan, scene: str) -> Table:
    """Every limit, and what the treatment comes to."""
    from rich.markup import escape
    from rich.table import Table

    from fitting.treatments.limits import in_units

    table = Table(title=escape(f"{scene}: {plan.treatment.describe()}"))
    for name in ("limit", "value", "holds"):
        table.add_column(name)
    for lim in plan.limits:
        value = plan.outcomes[lim.outcome]
        table.add_row(escape(lim.describe()), in_units(lim.outcome, value), "yes" if lim.room(value) >= 0 else "no")
    return table
