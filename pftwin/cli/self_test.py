"""The self-test of `pftwin doctor`: half a second of the virtual rig, judged by what mechanics demands of any run."""

from __future__ import annotations

import dataclasses
import time
from typing import NamedTuple

FRAMES = 61  # 0.6 s of case 1
MOST_CREATED = 0.04  # energy that no effect accounts for, as a share of the work done: 0.018 with steps of 1 ms


class SelfTestFinding(NamedTuple):
    """One thing that was looked at."""

    name: str
    found: str
    sound: bool
    remedy: str = ""


def self_test() -> list[SelfTestFinding]:
    """Simulates, and looks at what has to hold whatever the numbers are: balance at the start, energy, the float type.

    The first run on a machine compiles for some seconds; kept programs make the next one short.
    """
    import numpy as np

    from pftwin import rig
    from pftwin.dynamics.simulate import simulate
    from pftwin.dynamics.status import Status

    began = time.perf_counter()
    scene = rig.case(1)
    scene = dataclasses.replace(scene, motion=dataclasses.replace(scene.motion, n_frames=FRAMES))
    result = simulate(scene)
    seconds = time.perf_counter() - began
    start, energies = result.equilibrium, result.energies
    assert energies.work is not None
    assert energies.budget_error is not None
    work, created = (float(np.abs(v).max()) for v in (energies.work, energies.budget_error))
    share = created / work if work > 0 else float("nan")
    finite = bool(np.isfinite(result.position).all() and np.isfinite(result.quaternion).all())
    clean = finite and Status.NOT_FINITE not in result.status
    ran = f"{FRAMES} frames of case 1 in {seconds:.1f} s, compiling included"
    balance = f"{start.residual:.1e} N left over of the forces; at most {start.tolerance:.0e} N"
    budget = f"{100 * share:.1f} % of the work unaccounted for; at most {100 * MOST_CREATED:g} %"
    remedy = "a fresh environment: python -m venv; an empty cache folder"
    return [
        SelfTestFinding("simulation", f"{ran}: {result.status.describe()}", clean, remedy),
        SelfTestFinding("equilibrium at the start", balance, start.residual <= start.tolerance, remedy),
        SelfTestFinding("energy budget", budget, share <= MOST_CREATED, remedy),
        SelfTestFinding("precision of the run", result.dtype, result.dtype == "float64", "unset JAX_ENABLE_X64"),
    ]
