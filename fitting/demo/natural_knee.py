"""Demonstration: the natural knee (synthetic) before and after a tuberosity transfer, as numbers, a page and a film."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.errors import InputError, MissingExtraError
from pftwin.base.sheet import Sheet

if TYPE_CHECKING:
    from pftwin.results.result import Result

TT_TG = 19.8  # mean of knees that dislocate [mm], Dejour et al. 1994
MEDIALISATION = 0.010  # [m]
STEP = 1 / 120  # [s]
AT = (30, 60, 90)  # knee flexion of the table, as the knee bends [deg]
QUANTITIES = {"contact force, N": "contact_force", "tilt, deg": "patella_tilt", "shift, mm": "patella_shift"}


def run_knee(folder: Path, progress: Callable[..., None]) -> tuple[dict[str, Any], list[Sheet | str]]:
    """Simulates both knees, draws and saves before.nc, after.nc, knee.html and knee.gif in a folder.

    Returns the results as plain values, and as a table and lines. `progress` is called with the number of steps done
    and of all, and the next one (`what=`).
    """
    from fitting.treatments import tibial_tuberosity_transfer
    from pftwin import rig
    from pftwin.dynamics.simulate import simulate
    from pftwin.dynamics.status import status_facts

    folder.mkdir(parents=True, exist_ok=True)
    scene = rig.knee(rig.Anatomy(tt_tg_mm=TT_TG))
    scenes = {"before": scene, "after": tibial_tuberosity_transfer(scene, medialisation=MEDIALISATION)}
    results: dict[str, Result] = {}
    for done, (name, each) in enumerate(scenes.items()):
        progress(done, 4, what=f"{name} the transfer")
        results[name] = simulate(each, dt=STEP)
        results[name].save(folder / f"{name}.nc")
    rows = {label: {name: _at_flexions(r, key) for name, r in results.items()} for label, key in QUANTITIES.items()}
    drawn, words = _pictures(results, folder, progress)
    title = f"Natural knee (SYNTHETIC), TT-TG {TT_TG} mm, squat: {1e3 * MEDIALISATION:g} mm of medialisation"
    headings = ("knee flexion", *(f"{name}\n{at} deg" for at in AT for name in results))
    parts: list[Sheet | str] = [
        Sheet(title, headings, tuple(_cells(label, values) for label, values in rows.items()), words=(0,)),
        *(f"{name}: {result.status.describe()}" for name, result in results.items()),
        *words,
        f"results are in {folder}",
    ]
    facts = {
        "synthetic": True,
        "flexion_deg": list(AT),
        "table": [{"quantity": label, **values} for label, values in rows.items()],
        "status": {name: status_facts(result.flags) for name, result in results.items()},
        "doubts": [f"{r.verdict.describe()} ({name})" for name, r in results.items() if not r.verdict.valid],
        "files": [str(folder / name) for name in ("before.nc", "after.nc", *drawn)],
    }
    return facts, parts


def _at_flexions(result: Result, name: str) -> list[float]:
    """A quantity's values at the flexions of the table."""
    data = result.to_dataset()
    flexion = data["knee_flexion"].values
    bending = slice(0, int(np.argmax(flexion)) + 1)
    size = 1e3 if data[name].attrs["units"] == "m" else 1.0
    return [size * float(np.interp(at, flexion[bending], data[name].values[bending])) for at in AT]


def _cells(label: str, values: dict[str, list[float]]) -> tuple[str, ...]:
    """Values before and after at each flexion."""
    return label, *(f"{value:.1f}" for at in zip(*values.values(), strict=True) for value in at)


def _pictures(results: dict[str, Result], folder: Path, progress: Callable[..., None]) -> tuple[list[str], list[str]]:
    """Names of the files drawn, and lines that say why others were not, which need extras and a browser."""
    from pftwin.results.viewer import view
    from pftwin.results.viewer.film import write_film

    drawn: list[str] = []
    try:
        progress(2, 4, what="drawing")
        plot = view(results, folder / "knee.html", side_by_side=True)
        drawn.append("knee.html")
        progress(3, 4, what="filming")
        write_film(plot, folder / "knee.gif", see_through=True)
        drawn.append("knee.gif")
    except (MissingExtraError, InputError) as error:
        return drawn, [f"drawn: {', '.join(drawn) or 'nothing'}; {error}"]
    return drawn, [f"drawn: {', '.join(drawn)}"]
