"""In how many of the rig's four cases is a shifted channel reported? `python tests/verification/time_shifts.py`.

Each channel of the SYNTHETIC measurements is shifted in turn, late and early; fits are quick ones on P5. Prints the
table of docs/fitting.md, and exits with 1 if a shift is reported of measurements as they are.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import fitting
import pftwin
from pftwin import rig
from pftwin.model.measured import Measured

CASES = (1, 2, 3, 4)
SHIFTS = (0.03, 0.05, -0.03, -0.05)  # [s], positive late
FORCES = {"contact": "contact_force", "quadriceps": "femoral_spring_force", "patellar_tendon": "tibial_spring_force"}
FITS = {("position",): ("position",), ("position", "quadriceps"): ("position", "quadriceps")}
FITS["all"] = ("position", "contact", "quadriceps", "patellar_tendon")


def shifted(measured: Measured, channel: str, seconds: float) -> Measured:
    """The measurements with one channel late by so much."""
    name = FORCES.get(channel, "center")
    columns = np.asarray(getattr(measured, name)).reshape(measured.times.size, -1)
    late = np.stack([np.interp(measured.times - seconds, measured.times, c) for c in columns.T], axis=1)
    return replace(measured, **{name: late if name == "center" else late[:, 0]})


def reported(case: int, use: str | tuple[str, ...], channel: str, seconds: float) -> bool:
    """Whether the fit says that the channel is late or early; a refusal says so too."""
    measured = rig.measured(case)
    if seconds:
        measured = shifted(measured, channel, seconds)
    try:
        said = fitting.fit_tendons(rig.case(case), measured, use=use).doubts
    except pftwin.InputError as error:
        said = [str(error)]
    words = ("late against the motion", "early against the motion")
    return any(f"measured {channel} " in doubt and any(w in doubt for w in words) for doubt in said)


def main() -> int:
    """Prints the table."""
    print("channel | fitted to |", " | ".join(f"{1e3 * s:+.0f} ms" for s in SHIFTS), "| as measured")
    false = 0
    for use, channels in FITS.items():
        for channel in channels:
            counts = [sum(reported(c, use, channel, s) for c in CASES) for s in (*SHIFTS, 0.0)]
            false += counts[-1]
            print(f"{channel} | {use if use == 'all' else ', '.join(use)} |", " | ".join(map(str, counts)), flush=True)
    return int(false > 0)


if __name__ == "__main__":
    sys.exit(main())
