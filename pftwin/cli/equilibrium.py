"""`pftwin equilibrium`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pftwin.cli.exit_codes import flagged
from pftwin.cli.scenes import CaseOption, ContactOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.dynamics.equilibrium_report import EquilibriumReport


def equilibrium(
    scene: SceneArgument = None, *, case: CaseOption = None, contact: ContactOption = None, json: JsonOption = None
) -> None:
    """Find the static equilibrium at the first frame of the motion.

    Example: `pftwin equilibrium --case 2 --contact P4`
    """
    check_outputs(json)
    chosen = chosen_scene(scene, case, contact)
    from pftwin.dynamics.simulate import equilibrium as solve

    with working(f"solving for the equilibrium of {chosen.scene.name}"):
        report = solve(chosen.scene)
    write_json({"scene": chosen.scene.name, "contact": chosen.contact, **report.to_dict()}, json)
    console = out(json)
    console.print(f"{chosen.scene.name}: {report.description}", markup=False, highlight=False)
    console.print(_table(report))
    if not report.converged:
        flagged(f"{chosen.scene.name}: no equilibrium was found; try: a start pose nearer to where the patella rests")


def _table(report: EquilibriumReport) -> Table:
    """Pose, residual and what every effect reports."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, show_header=False)
    table.add_row(escape("patella in the femur [mm]"), "  ".join(f"{1e3 * v:.3f}" for v in report.position))
    table.add_row("quaternion (w, x, y, z)", "  ".join(f"{v:.6f}" for v in report.quaternion))
    table.add_row(escape("residual [N]"), f"{report.residual:.1e} after {report.iterations} iterations")
    for name, seen in report.effects.items():
        for key, value in seen.items():
            if value.ndim == 0:
                table.add_row(f"{name} {key}".replace("_", " "), f"{float(value):.6g}")
    return table
