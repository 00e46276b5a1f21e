"""What of a batch is shared out by more devices and processes, and what is not.

The study of `pftwin.benchmarks.batches`. Each number of devices has a process of its own, whose memory is looked at
after every size; what it spends outside of compiled programs is the part that more devices do not make shorter. More
devices than there are cores show what laying a batch over them costs, and gain nothing. Parts are written, read and
joined without anything being computed. `pftwin.benchmarks.extrapolation` makes a cluster's times of it.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from pftwin.benchmarks.batches import SETTINGS, amounts, peak, transferred
from pftwin.benchmarks.row import Row

SIZES, QUICK_SIZES = (1, 16, 128, 1_024, 10_000, 100_000), (16, 1_024)
MANY = (8, 32)  # devices, more than there are cores
MANY_SIZE, QUICK_MANY_SIZE = 7_680, 960  # members laid over them
PART = 1_920  # members of a part
PARTS = 20
TOPIC = "scaling"


def rows(quick: bool) -> list[Row]:
    """Of processes that are started one after the other."""
    from pftwin.benchmarks.processes import Team
    from pftwin.benchmarks.topics import in_a_process

    def apart(**task: Any) -> list[Row]:
        return in_a_process({"topic": TOPIC, **task}, "pftwin.benchmarks.scaling")

    found, sizes, many = [], QUICK_SIZES if quick else SIZES, QUICK_MANY_SIZE if quick else MANY_SIZE
    for devices in (1, 2):
        found += apart(devices=devices, sizes=sizes)
    for devices in (2, *MANY):
        found += apart(devices=devices, sizes=(many,))
    found += apart(devices=1, sizes=())
    starts = []
    for _ in range(2):  # the first compiles, or finds what was kept
        began = time.perf_counter()
        team = Team(1, PART)
        try:
            team.seconds("-")
            first = time.perf_counter() - began
            starts.append((first, team.seconds("-")[0]))
        finally:
            team.leave()
    first, again = starts[-1]
    details = {"first_s": first, "again_s": again, "compiling_s": starts[0][0]}
    note = f"{first:.1f} s to {PART:,} variants in a new process, {again:.2f} s there again"
    return [*found, Row(TOPIC, "start of a process, programs kept", first - again, "s", note=note, details=details)]


@contextmanager
def clocked() -> Iterator[list[float]]:
    """The seconds of each run of a compiled program meanwhile, waited for. For batches computed in one thread."""
    import jax

    from pftwin.batch.spread import Spread

    plain, spent = Spread.run, []

    def run(*args: Any) -> Any:
        began = time.perf_counter()
        out = jax.block_until_ready(plain(*args))
        spent.append(time.perf_counter() - began)
        return out

    with patch.object(Spread, "run", run):
        yield spent


def of_sizes(devices: int, sizes: tuple[int, ...]) -> list[Row]:
    """Time and memory of this process for batches of these sizes over so many devices."""
    import pftwin

    scene, found = pftwin.rig.case(2, contact="P5"), []

    def study(count: int) -> tuple[float, float]:
        many = pftwin.Variants(scene, transferred, amounts(count))
        with clocked() as spent:
            began = time.perf_counter()
            pftwin.simulate_batch(many, devices=devices, **SETTINGS)
            return time.perf_counter() - began, sum(spent)

    for count in sizes:
        study(min(count, 1_920))  # compiles
        warm = [study(count) for _ in range(3 if count < 50_000 else 1)]
        seconds, programs = (statistics.median(w[i] for w in warm) for i in (0, 1))
        outside = statistics.median(all_of_it - inside for all_of_it, inside in warm)
        details = {"devices": devices, "members": count, "seconds": seconds, "programs_s": programs}
        details |= {"outside_s": outside, "warm": warm, "peak_MiB": peak()}
        note = f"{seconds:.3g} s, {1e3 * outside:.3g} ms of it outside of programs; memory so far {peak():.0f} MiB"
        what = f"{count:,} variants, {devices} device{'s' * (devices > 1)}: time per variant"
        found.append(Row(TOPIC, what, 1e3 * seconds / count, "ms", note=note, details=details))
    return found


def of_parts() -> list[Row]:
    """Writing parts, reading them back, and joining them."""
    import pftwin
    from pftwin.batch.part_files import Index, read_part, write_part
    from pftwin.batch.parts import joined

    scene = pftwin.rig.case(2, contact="P5")
    members = pftwin.simulate_batch(pftwin.Variants(scene, transferred, amounts(PART)), devices=1, **SETTINGS)
    index = Index("0" * 64, {}, [PART] * PARTS)
    there: dict[int, Any] = {0: members}

    def read(folder: Path, unit: int) -> None:
        there[unit] = read_part(folder, unit, index, like=members)

    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as name:
        folder = Path(name)
        written = [_seconds(lambda u=u: write_part(folder, u, index.key, members)) for u in range(PARTS)]
        taken = [_seconds(lambda u=u: read(folder, u)) for u in range(PARTS)]
        size = sum(p.stat().st_size for p in folder.iterdir()) / (PARTS * PART)
    together = [_seconds(lambda: joined(list(there.values()))) for _ in range(5)]
    held = members.nbytes / PART
    return [
        Row(TOPIC, f"a part of {PART:,} variants: written", 1e3 * statistics.median(written), "ms",
            note=f"{size:.0f} bytes a variant on the disk", details={"seconds": written, "bytes": size}),
        Row(TOPIC, f"a part of {PART:,} variants: read", 1e3 * statistics.median(taken), "ms",
            note=f"{held:.0f} bytes a variant in memory", details={"seconds": taken, "bytes": held}),
        Row(TOPIC, f"{PARTS} parts joined: time per variant", 1e6 * statistics.median(together) / (PARTS * PART), "us",
            details={"seconds": together}),
    ]  # fmt: skip


def _seconds(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def work(task: dict[str, Any], target: Path) -> None:
    """Measures and writes the rows as JSON: `python -m pftwin.benchmarks.scaling TASK TARGET`."""
    import pftwin

    pftwin.configure(cpu_devices=task["devices"])
    found = of_sizes(task["devices"], tuple(task["sizes"])) if task["sizes"] else of_parts()
    target.write_text(json.dumps([row.to_json() for row in found]), encoding="utf-8")


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
