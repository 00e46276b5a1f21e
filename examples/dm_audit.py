"""Cost and influence of each effect of the DM knee: `pftwin explain` and `pftwin audit` on the scene of dm_knee.py.

    python examples/dm_audit.py FOLDER_OF_DM_KNEE [--contact patch|mesh] [--tolerance 0.1] [--markdown] [-o FOLDER]

The folder may be omitted if PFTWIN_DATA names the folder that contains dm_knee. docs/audit.md has the results.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from dm_knee import build

import pftwin
from pftwin import PftwinError
from pftwin.base.sheet import to_csv
from pftwin.base.text_files import write_text
from pftwin.cli.terminal import show
from pftwin.files.result_files import save_dataset
from pftwin.results.plots import save_figure
from pftwin.studies.audit.audit import audit
from pftwin.studies.audit.explain import explain
from pftwin.studies.audit.report import audit_figure, audit_sheet, dataset, explanation_sheet, table


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    data = os.environ.get("PFTWIN_DATA")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?" if data else None, default=data and Path(data) / "dm_knee")
    parser.add_argument("--contact", choices=("patch", "mesh"), default="patch", help="sphere on a patch, or meshes")
    parser.add_argument("--tolerance", type=float, default=0.1, help="change of the path that matters [mm]")
    parser.add_argument("--dt", type=float, help="time step [s]; default: that of simulate")
    parser.add_argument("--markdown", action="store_true", help="print the tables as Markdown")
    parser.add_argument("-o", "--out", type=Path, help="folder for figure, CSV and NetCDF")
    given = parser.parse_args(arguments)
    pftwin.configure(cache_dir=os.environ.get("PFTWIN_CACHE"))
    try:
        scene = build(given.folder, contact=given.contact).scene
        show(explanation_sheet(explain(scene, dt=given.dt)), markdown=given.markdown)
        found = audit(scene, tolerance=1e-3 * given.tolerance, dt=given.dt)
        show(audit_sheet(found), markdown=given.markdown)
        if given.out:
            given.out.mkdir(parents=True, exist_ok=True)
            write_text(given.out / "audit.csv", to_csv(table(found)))
            save_dataset(dataset(found), given.out / "audit.nc")
            title = f"{found.scene} (recording simulated by OpenSim JAM): influence of each effect"
            save_figure(audit_figure(found, title), given.out / "audit")
    except PftwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
