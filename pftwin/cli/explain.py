"""`pftwin explain`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pftwin.cli.scenes import CaseOption, ContactOption, IntegratorOption, SceneArgument, StepOption, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.audit.explain import Explanation, PartCost

_LONG = 1.0  # [s]: steps beyond are no limit


def explain(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: ContactOption = None,
    integrator: IntegratorOption = "linear_implicit",
    dt: StepOption = 1e-3,
    json: JsonOption = None,
) -> None:
    """Say what each effect of a scene adds: equations, time, stiffness, and the energy it moved over the run.

    Example: `pftwin explain --case 2`
    """
    check_outputs(json)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.audit.explain import explain as look

    with working(f"running {chosen.scene.name} with and without each effect"):
        found = look(chosen.scene, integrator=integrator, dt=dt)
    from pftwin.benchmarks.machine import describe

    write_json({"contact": chosen.contact, **found.to_dict(), "machine": describe()}, json)
    console = out(json)
    console.print(_table(found))
    for line in _notes(found):
        console.print(line, markup=False, highlight=False)


def _table(found: Explanation) -> Table:
    """A row for each part, one for what they share, and the whole."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"{found.scene}: {found.integrator}, steps of {1e3 * found.step:.3g} ms"))
    for heading in ("effect", "computed by"):
        table.add_column(heading)
    for heading in ("equations", "share of time", "explicit up to", "stiff", "work on patella", "moved", "heat"):
        table.add_column(heading, justify="right")
    for part in found.parts:
        table.add_row(*(escape(cell) for cell in _cells(part)))
    table.add_section()
    rest = ["inertia, guided motion, solution", "", str(found.shared_equations), f"{found.shared_time:.0%}"]
    table.add_row(*rest, "", "", "", "", "")
    total = ["one step", f"{1e6 * found.step_time:.2f} us", str(found.equations), "100%"]
    table.add_row(*total, "", "", f"{1e3 * found.kinetic_change:+.3f} mJ kinetic", "", "")
    return table


def _cells(part: PartCost) -> list[str]:
    name = part.name if part.of is None else f"  of which {part.name.removeprefix(part.of + ': ')}"
    return [
        name,
        part.kind,
        f"{part.equations:+d}",
        f"{part.share:.1%} ± {part.spread:.1%}",
        "any" if part.longest_step > _LONG else f"{1e3 * part.longest_step:.2g} ms",
        "yes" if part.stiff else "no",
        *(_energy(x) for x in (part.work, part.moved, part.heat)),
    ]


def _energy(joules: float) -> str:
    if not math.isfinite(joules):
        return "not finite"
    return f"{1e3 * joules:,.0f} mJ" if abs(joules) >= 0.1 else f"{1e3 * joules:.3g} mJ"


def _notes(found: Explanation) -> list[str]:
    """How to read the table, and how far to trust it."""
    notes = [
        "equations, share: what goes when the effect is left out; the rest is what none takes alone, so it may be negative",
        f"explicit up to: the longest step an explicit method could take; stiff: shorter than {1e3 * found.step:.3g} ms",
        f"energy over {found.steps} steps; the works miss the kinetic energy by {1e3 * found.energy_gap:.2g} mJ; "
        f"{found.programs} programs compiled",
    ]
    return [*notes, *([f"status: {found.status.describe()}"] if found.status else [])]
