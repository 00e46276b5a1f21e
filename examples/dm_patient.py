"""The DM recording as a patient: two elastic tendons fitted to the patella's poses, and tested on forces not used.

    python examples/dm_patient.py FOLDER_OF_DM_KNEE [-o dm_patient] [--starts 32]

prints tables and writes figures and estimates to the folder after -o. The data folder may be omitted if PFTWIN_DATA
names the folder that contains dm_knee. docs/worked_knees.md explains the steps and the results. The recording is
itself a simulation, by OpenSim JAM (see `examples/dm_knee.py`); tables and figures state this.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

import dm_patient_report as shown
import dm_treatments
from dm_patient_fit import FITS, fit, ideal, judge, prepare, tension_bands

import pftwin
from pftwin import PftwinError


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    data = os.environ.get("PFTWIN_DATA")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?" if data else None, default=data and Path(data) / "dm_knee")
    parser.add_argument("--starts", type=int, default=32, help="number of starts of the search")
    parser.add_argument("-o", "--out", type=Path, default=Path("dm_patient"), help="folder for figures and estimates")
    given = parser.parse_args(arguments)
    pftwin.configure(cache_dir=True)
    try:
        given.out.mkdir(parents=True, exist_ok=True)
        report(given.folder, given.out, given.starts)
    except (PftwinError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def report(folder: Path, out: Path, starts: int) -> None:
    """Fits and simulates the patient; prints tables and writes figures and estimates."""
    case = prepare(folder)
    shown.print_patient(case)
    found = {}
    for name, what in FITS.items():
        found[name] = judge(case, fit(case, what, starts=starts))
        shown.print_fit(name, found[name])
        found[name].estimate.save(out / f"{'_'.join(re.findall('[a-z]+', name))}.json")
    shown.print_comparison(case, found)
    shown.print_ideal(ideal(case, found["positions, one force"].estimate))
    shown.save_figures(case, found, {n: tension_bands(case, o.estimate) for n, o in found.items()}, out)
    dm_treatments.report(case.knee.scene, out)


if __name__ == "__main__":
    sys.exit(main())
