"""`pftwin validate`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pftwin.base.errors import InputError
from pftwin.cli.exit_codes import check_trust
from pftwin.cli.scenes import (
    CaseOption,
    ContactOption,
    IntegratorOption,
    SceneArgument,
    StepOption,
    ToleranceOption,
    chosen_scene,
    simulated,
)
from pftwin.cli.terminal import JsonOption, check_outputs, out, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.results.metrics import Validation


def validate(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: ContactOption = None,
    integrator: IntegratorOption = None,
    dt: StepOption = None,
    tolerance: ToleranceOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate, and compare with the measurements: the rows of Table 1 of Michaud et al. 2024.

    Example: `pftwin validate --case 1 --contact P5`
    """
    check_outputs(json)
    chosen = chosen_scene(scene, case, contact)
    if chosen.measured is None:
        raise InputError("nothing to compare with", where=scene, expected="a table [measured] in the scene file")
    from pftwin.results.metrics import PAPER_TABLE_1
    from pftwin.results.metrics import validate as compare

    result, first = simulated(chosen, integrator, dt, tolerance)
    names = {e.name for e in chosen.scene.effects}
    springs: dict[str, Any] = {}
    if chosen.measured.tibial_spring_force is None and "patellar_tendon" not in names:
        springs["tibial"] = None
    if chosen.measured.femoral_spring_force is None and "quadriceps" not in names:
        springs["femoral"] = None
    validation = compare(result, chosen.measured, **springs)
    paper = chosen.contact if chosen.contact in PAPER_TABLE_1 else None
    rows = [row._asdict() for row in validation.to_rows(paper)]
    write_json({"contact": chosen.contact, **validation.to_dict(), "first_run_s": first, "rows": rows}, json)
    out(json).print(_table(validation, paper))
    check_trust(result)


def _table(validation: Validation, paper: str | None) -> Table:
    """The rows, the paper's means over its four cases beside them."""
    from rich.markup import escape
    from rich.table import Table

    against = "synthetic measurements" if validation.synthetic else "measurements"
    table = Table(title=escape(f"{validation.scene} against {against}"))
    table.add_column("", no_wrap=True)
    table.add_column("this", justify="right")
    if paper is not None:
        table.add_column(f"paper, {paper}", justify="right")
    table.add_column("unit")
    for row in validation.to_rows(paper):
        cells = [_number(row.value), _number(row.paper)] if paper is not None else [_number(row.value)]
        table.add_row(row.label, *cells, row.unit)
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
