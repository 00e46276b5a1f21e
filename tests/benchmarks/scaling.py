"""What of a batch is shared out by more devices and processes, and what is not.

The study of `tests.benchmarks.batches`. Each number of devices has a process of its own, whose memory is looked at
after every size; what it spends outside of compiled programs is the part that more devices do not make shorter. More
devices than there are cores show what laying a batch over them costs, and gain nothing. Parts are written, read and
joined without anything being computed. `tests.benchmarks.extrapolation` makes a cluster's times of it.
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

from tests.benchmarks.batches import SETTINGS, amounts, peak, transferred
from tests.benchmarks.row import Row

SIZES, QUICK_SIZES = (1, 16, 128, 1_024, 10_000, 100_000), (16, 1_024)
MANY = (8, 32)  # devices, more than there are cores
MANY_SIZE, QUICK_MANY_SIZE = 7_680, 960  # members laid over them
PART, LARGE_PART = 1_920, 7_680  # members of parts that are written and read
PARTS = 20
TOPIC = "scaling"


def rows(quick: bool) -> list[Row]:
    """Of processes that are started one after the other."""
    from tests.benchmarks.topics import in_a_process

    def apart(**task: Any) -> list[Row]:
        return in_a_process({"topic": TOPIC, **task}, "tests.benchmarks.scaling")

    found, sizes, many = [], QUICK_SIZES if quick else SIZES, QUICK_MANY_SIZE if quick else MANY_SIZE
    for devices in (1, 2):
        found += apart(devices=devices, sizes=sizes)
    for devices in (2, *MANY):
        found += apart(devices=devices, sizes=(many,))
    for part in (PART, LARGE_PART):
        found += apart(devices=1, part=part)
    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as cache:
        starts = [_start(cache) for _ in range(3)]  # the first compiles
    compiling = starts[0][0]
    first, again = (statistics.median(s[i] for s in starts[1:]) for i in (0, 1))
    note = f"{first:.1f} s to a part of {PART:,} variants in a new process, {compiling:.0f} s where it has to compile"
    details = {"first_s": first, "again_s": again, "starts": starts}
    return [*found, Row(TOPIC, "start of a process, programs kept", first - again, "s", note=note, details=details)]


def _start(cache: str) -> tuple[float, float]:
    """Seconds from nothing to a part in a new process, and to another one there; with a folder of kept programs."""
    from tests.benchmarks.processes import Team

    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as folder:
        began = time.perf_counter()
        team = Team(1, PART, cache)
        try:
            team.seconds(str(Path(folder) / "first"))
            return time.perf_counter() - began, team.seconds(str(Path(folder) / "again"))[0]
        finally:
            team.leave()


@contextmanager
def clocked() -> Iterator[list[float]]:
    """The seconds of each run of a compiled program meanwhile, waited for. For batches computed in one thread."""
    import jax

    from pftwin.dynamics.batch.batched import Sharding

    plain, spent = Sharding.run, []

    def run(*args: Any) -> Any:
        began = time.perf_counter()
        out = jax.block_until_ready(plain(*args))
        spent.append(time.perf_counter() - began)
        return out

    with patch.object(Sharding, "run", run):
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
        warm = [study(count) for _ in range(3)]
        seconds, programs = (statistics.median(w[i] for w in warm) for i in (0, 1))
        outside = statistics.median(all_of_it - inside for all_of_it, inside in warm)
        details = {"devices": devices, "members": count, "seconds": seconds, "programs_s": programs}
        details |= {"outside_s": outside, "warm": warm, "peak_MiB": peak()}
        note = f"{seconds:.3g} s, {1e3 * outside:.3g} ms of it outside of programs; memory so far {peak():.0f} MiB"
        what = f"{count:,} variants, {devices} device{'s' * (devices > 1)}: time per variant"
        found.append(Row(TOPIC, what, 1e3 * seconds / count, "ms", note=note, details=details))
    return found


def of_parts(size: int) -> list[Row]:
    """Writing parts of so many members, reading them back, and joining them."""
    import pftwin
    from pftwin.dynamics.batch.parts import BatchIndex, concatenated_parts, read_part, write_part

    scene = pftwin.rig.case(2, contact="P5")
    members = pftwin.simulate_batch(pftwin.Variants(scene, transferred, amounts(size)), devices=1, **SETTINGS)
    index, there = BatchIndex("0" * 64, {}, [size] * PARTS), []
    with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as name:
        folder = Path(name)
        written = [_seconds(lambda u=u: write_part(folder, u, index.key, members)) for u in range(PARTS)]
        taken = [_seconds(lambda u=u: there.append(read_part(folder, u, index, like=members))) for u in range(PARTS)]
        on_disk = sum(p.stat().st_size for p in folder.iterdir()) / (PARTS * size)
    together = [_seconds(lambda: concatenated_parts(there)) for _ in range(5)]
    note, found = f"{on_disk:.0f} bytes a variant on the disk, {members.nbytes / size:.0f} in memory", []
    for what, all_of_them, parts in (("written", written, 1), ("read", taken, 1), ("joined", together, PARTS)):
        seconds = statistics.median(all_of_them) / parts
        details = {"part": size, "seconds": seconds, "all": all_of_them}
        found.append(
            Row(TOPIC, f"a part of {size:,} variants: {what}", 1e3 * seconds, "ms", note=note, details=details)
        )
    return found


def _seconds(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def work(task: dict[str, Any], target: Path) -> None:
    """Measures and writes the rows as JSON: `python -m tests.benchmarks.scaling TASK TARGET`."""
    import pftwin

    pftwin.configure(cpu_devices=task["devices"])
    found = of_parts(task["part"]) if "part" in task else of_sizes(task["devices"], tuple(task["sizes"]))
    target.write_text(json.dumps([row.to_json() for row in found]), encoding="utf-8")


if __name__ == "__main__":
    work(json.loads(sys.argv[1]), Path(sys.argv[2]))
