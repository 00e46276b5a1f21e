"""`pftwin plan-experiment`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fitting.cli.fit import FreeOption, NoiseOption, UseOption, names_in, noise_levels
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from fitting.identifiability import ExperimentPlan


def plan_experiment(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: ContactOption = None,
    free: FreeOption = "K1,L1,K2,L2",
    use: UseOption = "position",
    noise: NoiseOption = None,
    json: JsonOption = None,
) -> None:
    """Say what an experiment can tell at best, before it is made, and what to measure besides.

    Example: `pftwin plan-experiment --case 2 --use position --noise position=2e-4`
    """
    check_outputs(json)
    levels = noise_levels(noise)
    chosen = chosen_scene(scene, case, contact)
    from fitting.identifiability import plan_experiment as plan
    from fitting.programs import channels_of

    channels = channels_of(chosen.scene) if use.strip() == "all" else names_in(use)
    with working("linearising the motion"):
        found = plan(chosen.scene, free=names_in(free), use=channels, noise=levels)
    write_json({"scene": chosen.scene.name, **found.to_dict()}, json)
    console = out(json)
    console.print(_table(found, chosen.scene.name))
    console.print(found.sentence(), markup=False, highlight=False)


def _table(plan: ExperimentPlan, scene: str) -> Table:
    """Smallest standard deviations, with what is planned and with one more measurement."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(f"{scene}: smallest possible standard deviations [%]"))
    table.add_column("measured", no_wrap=True)
    for name in plan.names:
        table.add_column(escape(name), justify="right")
    table.add_row(", ".join(plan.channels), *(f"{100 * v:.3g}" for v in plan.relative))
    for channel, values in plan.additions.items():
        table.add_row(f"and {channel}", *(f"{100 * v:.3g}" for v in values))
    return table
