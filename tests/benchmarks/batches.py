"""What batches over devices cost: what a second device brings, a variant in batches of every size, memory.

The study: transfers of the tibial tuberosity on case 2 of the rig (P5), the whole motion of 7.2 s, by steps of 5 ms of
`linear_implicit_bdf2`, which hold 0.05 mm, without the account of energy. One process: what is compiled serves all
sizes.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array

from pftwin.base.spatial import Vec3
from pftwin.dynamics.integrators import BDF2
from pftwin.model.scene import Scene
from tests.benchmarks.row import Row

SIZES, QUICK_SIZES = (1, 16, 128, 1_024, 10_000, 100_000), (1, 16, 1_024)
RATIO_SIZE = 3_840  # 32 pieces: as many for every device
FASTER, ALIKE, MINUTE, MEMORY = 1.8, 1.2, 60.0, 4_096.0  # times, times, s, MiB
FARTHEST_MEDIAL, FARTHEST_DISTAL = 0.015, 0.010  # [m]
SETTINGS: dict[str, Any] = {
    "dt": 5e-3,
    "integrator": BDF2(),
    "trajectories": False,
    "energy_budget": False,
}


def transferred(scene: Scene, row: Array) -> Scene:
    """The tuberosity moved medially and distally: the patellar tendon's place on the tibia (x proximal, y lateral)."""
    tendon: Any = scene.effect("patellar_tendon")
    o = tendon.origin
    return scene.with_effect(eqx.tree_at(lambda t: t.origin, tendon, Vec3(o.x - row[1], o.y - row[0], o.z)))


def amounts(count: int) -> np.ndarray:
    """Transfers (count, 2), scattered evenly [m]."""
    return np.random.default_rng(0).uniform(0, 1, (count, 2)) * (FARTHEST_MEDIAL, FARTHEST_DISTAL)


def rows(quick: bool) -> list[Row]:
    """Of this process, whose CPU devices are counted by now."""
    import jax

    import pftwin

    scene = pftwin.rig.case(2, contact="P5")

    def study(count: int, devices: int | str = "all") -> tuple[float, Any]:
        many = pftwin.Variants(scene, transferred, amounts(count))
        began = time.perf_counter()
        found = pftwin.simulate_batch(many, devices=devices, **SETTINGS)
        return time.perf_counter() - began, found

    said = f"{len(jax.devices())} devices"
    out, per_variant, found = [], {}, None
    for count in QUICK_SIZES if quick else SIZES:
        cold, _ = study(count) if count < RATIO_SIZE else (0.0, None)
        warm = [study(count) for _ in range(3 if count < 50_000 else 1)]
        seconds, found = statistics.median(w[0] for w in warm), warm[-1][1]
        per_variant[count] = seconds / count
        details = {"cold_s": cold, "warm_s": [w[0] for w in warm], "recomputed": found.attrs["recomputed_members"]}
        what = f"{count:,} variants, warm: time per variant"
        note = f"{seconds:.3g} s, {said}; recomputed: {details['recomputed']}"
        out.append(Row("batches", what, 1e3 * seconds / count, "ms", note=note, details=details))
        if count == 100_000:
            out.append(Row("batches", f"{count:,} variants, warm", seconds, "s", MINUTE, "at most", said, details))
    largest = max(per_variant)
    ratio = per_variant[largest] / per_variant[1_024]
    what = f"time per variant at {largest:,} against at 1,024"
    out.append(Row("batches", what, ratio, "times", ALIKE, "at most"))
    out.append(Row("batches", "largest memory of the process", peak(), "MiB", MEMORY, "at most", said))
    if len(jax.devices()) > 1:
        out.append(_ratio(study, 960 if quick else RATIO_SIZE))
    return out


def _ratio(study: Any, count: int) -> Row:
    """One device against two, in turn."""
    for devices in (1, 2):  # compiles
        study(count, devices)
    one, two = [], []
    for _ in range(3):
        one.append(study(count, 1)[0])
        two.append(study(count, 2)[0])
    ratios = [a / b for a, b in zip(one, two, strict=True)]
    details = {"one_device_s": one, "two_devices_s": two}
    note = f"{statistics.median(one):.2f} s against {statistics.median(two):.2f} s"
    what = f"{count:,} variants: two CPU devices against one"
    return Row("batches", what, statistics.median(ratios), "times", FASTER, "at least", note, details)


def peak() -> float:
    """The largest memory that this process has had [MiB]."""
    import resource

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / 2**20 if sys.platform == "darwin" else most / 2**10


def work(task: dict[str, Any], target: Path) -> None:
    """Measures and writes the rows as JSON: `python -m tests.benchmarks.batches TASK TARGET`."""
    import pftwin

    pftwin.configure(cpu_devices="all")
    target.write_text(json.dumps([row.to_json() for row in rows(task["quick"])]), encoding="utf-8")


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
