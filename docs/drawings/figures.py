"""Draws the pictures of docs/figures.md: `python docs/drawings/figures.py [NAME ...]`, all of them without a name.

The fit and the posterior take minutes the first time; programs that were compiled are kept.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import fitting
import pftwin
from fitting.prediction.variants import grid
from fitting.treatments import tibial_tuberosity_transfer
from pftwin.base.runtime import default_cache_dir
from pftwin.results.plots import against_flexion, compared, house_style
from pftwin.studies.accuracy.table import read_csv, work_precision

HERE = Path(__file__).parent
FOLDER = HERE.parent / "figures"
DPI = 130
MOST = 120_000  # bytes of a picture
COLOURS = 256  # of a picture: lines on white need no more
DRAWS = 2000  # of each chain of the posterior


@cache
def run(case: int, contact: str = "P5") -> pftwin.Result:
    """A case of the virtual rig."""
    return pftwin.simulate(pftwin.rig.case(case, contact=contact))


@cache
def fit() -> fitting.Estimate:
    """Both tendons of case 2, from its positions and one force."""
    return fitting.fit_tendons(pftwin.rig.case(2), pftwin.rig.measured(2), use=("position", "quadriceps"))


def placed(amount: float) -> list[pftwin.Result]:
    """Case 1 with the tuberosity medially by an amount [m], which the surgeon meets to 2 mm."""
    amounts = amount + 1e-3 * np.linspace(-2, 2, 5)
    return [pftwin.simulate(tibial_tuberosity_transfer(pftwin.rig.case(1), a)) for a in amounts]


def cycles() -> Figure:
    """Strokes of one recording, simulated and measured."""
    return run(1).plot.against_flexion(measured=pftwin.rig.measured(1))


def over_variants() -> Figure:
    """Two treatments, each with the error of placing it."""
    groups = {"tuberosity as it is, ±2 mm": placed(0.0), "8 mm medially, ±2 mm": placed(8e-3)}
    return against_flexion(groups, strokes="bending", title="Case 1: how exactly must a tuberosity be placed?")


def trajectory() -> Figure:
    """The case that dislocates."""
    return run(2).plot.trajectory(measured=pftwin.rig.measured(2))


def comparison() -> Figure:
    """Two contact models beside the measurements."""
    return compared({"P2": run(1, "P2"), "P5": run(1)}, pftwin.rig.measured(1))


def correlation() -> Figure:
    """Of the fit."""
    return fit().plot.correlation()


def posterior() -> Figure:
    """Of the fit, sampled."""
    return fit().plot.posterior(fitting.sample_posterior(fit(), draws=DRAWS))


def response() -> Figure:
    """To a transfer of the tuberosity."""
    amounts = grid("tibial_tuberosity_transfer", medialisation=1e-3 * np.arange(0, 21, 2))
    return fit().plot.response(amounts, samples=50)


def precision() -> Figure:
    """The kept study of accuracy."""
    newest = max((HERE.parent / "benchmarks").glob("accuracy-*.csv"))
    return work_precision(
        read_csv(newest), "Case 1 of the virtual rig (synthetic), P5: what accuracy costs", contact="P5"
    )


ALL: dict[str, Callable[[], Figure]] = {
    "against_flexion": cycles,
    "variants": over_variants,
    "trajectory": trajectory,
    "compared": comparison,
    "correlation": correlation,
    "posterior": posterior,
    "response": response,
    "work_precision": precision,
}


def save(figure: Figure, path: Path) -> None:
    """As a PNG of few colours."""
    raw = BytesIO()
    with house_style():
        figure.savefig(raw, format="png", dpi=DPI)
    picture = (
        Image.open(raw).convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    )
    picture.save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path.name}: {size / 1e3:.0f} kB")
    if size > MOST:
        raise SystemExit(f"{path.name} has {size} bytes, more than {MOST}")


def main(names: list[str]) -> None:
    """Those that are named."""
    pftwin.configure(cache_dir=default_cache_dir())
    FOLDER.mkdir(exist_ok=True)
    for name in names or ALL:
        save(ALL[name](), FOLDER / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
