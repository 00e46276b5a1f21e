"""Lateral release and MPFL graft on the DM knee with all its 60 strands: a demonstration, not a treatment plan.

    python examples/dm_treatments.py FOLDER_OF_DM_KNEE [-o dm_patient]

The lateral strands are the LPFL's 15, the only ones on that side of this knee; the graft replaces the MPFL's 15. The
strands are straight. In the recording, the LPFL wraps the condyle and pulls twice as hard, so a release would have a
larger effect there.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from dm_knee import array, build
from rich.console import Console
from rich.table import Table

import fitting
import pftwin
from fitting.treatments import Treatment
from pftwin import PftwinError
from pftwin.model.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

RELEASE = (0.0, 0.25, 0.5, 0.75, 1.0)  # share of the lateral strands' stiffness that is removed
SHORTENING = (0.002, 0.004, 0.006, 0.008)  # of the MPFL's slack length [m]; 0 is the first release
_COLUMNS = (
    ("mean_shift", 1e3, "mean shift (mm)", ".2f"),
    ("mean_tilt", 1.0, "mean tilt (deg)", ".1f"),
    ("medial_share", 100.0, "medial share (%)", ".0f"),
    ("peak_contact_force", 1.0, "peak force (N)", ".0f"),
    ("dislocations", 1.0, "dislocated", ".0f"),
)


def predicted(scene: Scene) -> Dataset:
    """Predicts outcomes and time courses of every release, then of every graft, in one batch."""
    both = Treatment.of("lateral_release", release=0.0).then(Treatment.of("mpfl_graft", shortening=0.0))
    release = np.concatenate([RELEASE, np.zeros(len(SHORTENING))])
    shortening = np.concatenate([np.zeros(len(RELEASE)), SHORTENING])
    return fitting.predict(scene, both.with_values([array(release), array(shortening)]), trajectories=True)


def report(scene: Scene, out: Path) -> None:
    """Prints the table and draws the figure."""
    from pftwin.results.plots import save_figure

    data = predicted(scene)
    Console(soft_wrap=True).print(_table(data))
    save_figure(_figure(scene, data), out / "dm_treatments")


def _table(data: Dataset) -> Table:
    table = Table(title="Demonstration, not advice: treatments of the DM knee (shift and tilt lateral positive)")
    table.add_column("treatment", no_wrap=True)
    for _, _, heading, _ in _COLUMNS:
        table.add_column(heading, justify="right")
    for i in range(data.sizes["variant"]):
        cells = [f"{scale * float(data[name][i]):{form}}" for name, scale, _, form in _COLUMNS]
        table.add_row(_words(data, i), *cells)
    return table


def _words(data: Dataset, i: int) -> str:
    release = 100 * float(data["lateral_release_release"][i])
    shortening = 1e3 * float(data["mpfl_graft_shortening"][i])
    if shortening:
        return f"MPFL {shortening:.0f} mm shorter"
    return f"release {release:.0f} %" if release else "none"


def _figure(scene: Scene, data: Dataset) -> Figure:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from pftwin.dynamics.trajectory import knee_angles
    from pftwin.results.plots import STYLE

    knee = np.degrees(np.asarray(knee_angles(scene).flexion))
    groups = {
        "Lateral release": range(len(RELEASE)),
        "MPFL shortened": [0, *range(len(RELEASE), data.sizes["variant"])],
    }
    medial, lateral = (data[f"force_{side}"].values for side in ("medial", "lateral"))
    courses = (
        ("tilt, lateral positive [deg]", data["patella_tilt"].values),
        ("share of force on the medial facet [%]", 100 * medial / (medial + lateral)),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 6.6))
        panels = figure.subplots(2, 2, sharex=True, sharey="row")
        for j, (title, members) in enumerate(groups.items()):
            shades = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(members)))
            for i, (label, values) in enumerate(courses):
                for shade, member in zip(shades, members, strict=True):
                    panels[i, j].plot(knee, values[member], color=shade, label=_words(data, member))
                if j == 0:
                    panels[i, j].set_ylabel(label)
            panels[0, j].set_title(title)
            panels[0, j].legend(loc="best", fontsize=8)
            panels[1, j].set_xlabel("knee flexion [deg]")
        figure.suptitle("A demonstration of treatments: DM knee with 60 strands, motion simulated by OpenSim JAM")
    return figure


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    base = os.environ.get("PFTWIN_DATA")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?" if base else None, default=base and Path(base) / "dm_knee")
    parser.add_argument("-o", "--out", type=Path, default=Path("dm_patient"), help="folder for the figure")
    given = parser.parse_args(arguments)
    pftwin.configure(cache_dir=True)
    try:
        given.out.mkdir(parents=True, exist_ok=True)
        report(build(given.folder).scene, given.out)
    except (PftwinError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
