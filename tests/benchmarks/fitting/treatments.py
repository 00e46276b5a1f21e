"""What a large study of treatments costs."""

from __future__ import annotations

import math
import time

import numpy as np

from tests.benchmarks.row import Row

VARIANTS = 10_000
_QUICK_SIDE = 40  # a quarter of its square still fills whole chunks: the rest runs the same programs
SECONDS = 10.0  # warm, on two cores
FARTHEST_MEDIAL, FARTHEST_DISTAL = 0.020, 0.010  # transfers of the tibial tuberosity [m]


def rows(quick: bool) -> list[Row]:
    """Ten thousand transfers of case 2's tibial tuberosity in one call of `fitting.predict`."""
    import fitting
    import pftwin
    from fitting.prediction.variants import grid
    from tests.benchmarks.fitting.memory import peak

    scene, side = pftwin.rig.case(2), _QUICK_SIDE if quick else math.isqrt(VARIANTS)

    def study(side: int) -> tuple[float, float, float | None, int]:
        """Seconds, seconds of processor time, largest memory so far, and members that failed."""
        axes = (np.linspace(0, far, side) for far in (FARTHEST_MEDIAL, FARTHEST_DISTAL))
        transfers = grid("tibial_tuberosity_transfer", dict(zip(("medialisation", "distalisation"), axes, strict=True)))
        began, cpu = time.perf_counter(), time.process_time()
        found = fitting.predict(scene, transfers)
        return time.perf_counter() - began, time.process_time() - cpu, peak(), int(found.failed.sum())

    cold = study(side // 2)  # of a quarter of the size: compiles
    warm = [study(side) for _ in range(1 if quick else 3)]
    seconds, cpu, most, failed = sorted(warm)[len(warm) // 2]
    what = f"{side**2:,} variants of case 2's tibial tuberosity"
    note = f"{cpu:.1f} s of processor time, {failed} failed"
    details = {"cold_quarter_s": cold[0], "warm_s": [w[0] for w in warm], "cpu_s": cpu, "failed": failed}
    out = [Row("treatments", f"{what}, warm", seconds, "s", SECONDS, "at most", note, details)]
    if most is not None and cold[2] is not None:
        memory = {"quarter_MiB": cold[2], "all_MiB": most}
        note = f"{cold[2]:,.0f} MiB after a quarter of them: it does not grow with their number"
        note = note if most < 1.5 * cold[2] else f"{cold[2]:,.0f} MiB after a quarter of them"
        out.append(Row("treatments", f"{what}: largest memory of the process", most, "MiB", note=note, details=memory))
    return out
