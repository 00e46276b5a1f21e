"""`pftwin simulate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pftwin.base.errors import OutputError
from pftwin.cli.exit_codes import check_trust, keeping
from pftwin.cli.plugins import with_scene_changes
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
from pftwin.cli.terminal import JsonOption, check_outputs, out, working, write_json


@with_scene_changes
def simulate(
    scene: SceneArgument = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.nc", help="The result as NetCDF.")],
    case: CaseOption = None,
    contact: ContactOption = None,
    integrator: IntegratorOption = None,
    dt: StepOption = None,
    tolerance: ToleranceOption = None,
    change: Callable[[Any], Any] | None = None,
    csv: Annotated[bool, typer.Option("--csv", help="Also as a table, beside it: OUT.csv.")] = False,
    sto: Annotated[bool, typer.Option("--sto", help="Also for OpenSim, beside it: OUT.sto.")] = False,
    json: JsonOption = None,
) -> None:
    """Simulate the patella through the recorded motion, as it is or after a treatment.

    Example: `pftwin simulate --case 2 --medialise 16 -o after.nc`
    """
    if output.suffix.lower() != ".nc":
        raise OutputError(f"{output}: results are NetCDF; try: {output.with_suffix('.nc')}")
    table, storage = (output.with_suffix(".csv") if csv else None), (output.with_suffix(".sto") if sto else None)
    check_outputs(output, table, storage, json)
    chosen = chosen_scene(scene, case, contact)
    chosen = chosen if change is None else replace(chosen, scene=change(chosen.scene))
    result, first = simulated(chosen, integrator, dt, tolerance)
    with keeping(output, table, storage), working("writing"):
        result.save(output)
        if table is not None:
            result.to_csv(table)
        if storage is not None:
            result.to_sto(storage)
    written = [str(p) for p in (output, table, storage) if p is not None]
    write_json(
        {
            "scene": result.scene_name,
            "contact": chosen.contact,
            "frames": result.times.size,
            "duration_s": result.duration,
            "settings": result.settings,
            "timing": {**result.timing, "first_run_s": first},
            "real_time_factor": result.real_time_factor,
            "status": result.status.describe(),
            "largest_indentation_m": result.largest_indentation,
            "equilibrium": result.equilibrium.to_dict(),
            "dtype": result.dtype,
            "files": written,
        },
        json,
    )
    out(json).print(result.summary(), markup=False, highlight=False)
    out(json).print(f"written: {', '.join(written)}", markup=False, highlight=False)
    check_trust(result)
