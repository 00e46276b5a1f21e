"""A batch in parts over two processes against one, each on a core of its own, as a cluster would bind them.

The study of `tests.benchmarks.batches`. Three processes are started and kept: one alone, and two that
`jax.distributed` joins on loopback. Then one run of each in turn, so that the machine's other load falls on all alike;
who is not measured waits and takes no time. Every run begins with an empty folder and ends when all processes have the
whole dataset: keys, writing, meeting and reading are in it.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from pftwin.base.errors import PftwinError
from tests.benchmarks.batches import SETTINGS, amounts, transferred
from tests.benchmarks.row import Row

SIZE, QUICK_SIZE = 7_680, 3_840  # members: four parts, or two
FASTER = 1.7  # times


class Team:
    """Processes of one job, which wait to be told a folder.

    Args:
        count: how many.
        members: of the batch.
        cache: folder in which compiled programs are kept; None: nowhere.
    """

    def __init__(self, count: int, members: int, cache: str | None = None) -> None:
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            port = found.getsockname()[1]
        common = {"count": count, "port": port, "members": members, "cache": cache}
        tasks = [{"index": i, **common} for i in range(count)]
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-m", "tests.benchmarks.processes", json.dumps(one)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for one in tasks
        ]

    def seconds(self, folder: str) -> tuple[float, float]:
        """What a run into a folder takes, by the clock, and of processor time in the busiest process.

        Without parts where the folder is "-".

        Raises:
            PftwinError: a process failed.
        """
        began = time.perf_counter()
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.write(folder + "\n")
            process.stdin.flush()
        busiest = 0.0
        for process in self._processes:
            assert process.stdout is not None
            while not (line := process.stdout.readline()).startswith("done "):
                if not line:
                    raise PftwinError("a process of the measured job failed (its message is above)")
            busiest = max(busiest, float(line.split()[1]))
        return time.perf_counter() - began, busiest

    def leave(self) -> None:
        """Ends them."""
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.close()
        for process in self._processes:
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()


def rows(quick: bool) -> list[Row]:
    """Two processes against one, and what parts cost one."""
    members = QUICK_SIZE if quick else SIZE
    one, two = Team(1, members), Team(2, members)
    try:
        with tempfile.TemporaryDirectory(prefix="pftwin-benchmark-") as folder:
            for name, team in (("cold 1", one), ("cold 2", two)):  # compiles
                team.seconds(str(Path(folder) / name))
            one.seconds("-")
            runs: dict[str, list[tuple[float, float]]] = {"without_parts": [], "one_process": [], "two_processes": []}
            for i in range(3):
                runs["without_parts"].append(one.seconds("-"))
                runs["one_process"].append(one.seconds(str(Path(folder) / f"one {i}")))
                runs["two_processes"].append(two.seconds(str(Path(folder) / f"two {i}")))
    finally:
        one.leave()
        two.leave()
    details = {f"{name}_s": [seconds for seconds, _ in some] for name, some in runs.items()}
    plain, single, pair = details.values()
    details |= {f"{name}_busiest_cpu_s": [cpu for _, cpu in some] for name, some in runs.items()}
    what = f"{members:,} variants in parts"
    note = f"{statistics.median(single):.2f} s against {statistics.median(pair):.2f} s, a core each"
    ratio = statistics.median(a / b for a, b in zip(single, pair, strict=True))
    cost = statistics.median(a / b for a, b in zip(single, plain, strict=True))
    said = f"{statistics.median(single):.2f} s against {statistics.median(plain):.2f} s, one process"
    return [
        Row("processes", f"{what}: two processes against one", ratio, "times", FASTER, "at least", note, details),
        Row("processes", f"{what}: time against that without parts", cost, "times", note=said, details=details),
    ]


def member(index: int, count: int, port: int, members: int, cache: str | None) -> None:
    """A process of a team: `python -m tests.benchmarks.processes TOLD`."""
    if hasattr(os, "sched_setaffinity"):
        there = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {there[index % len(there)]})
    import jax

    import pftwin

    pftwin.configure(cpu_devices=1, cache_dir=cache)
    if count > 1:
        jax.distributed.initialize(f"127.0.0.1:{port}", count, index)
    batch = pftwin.Variants(pftwin.rig.case(2, contact="P5"), transferred, amounts(members))
    for line in sys.stdin:
        folder: Any = line.rstrip("\n")
        began = time.process_time()
        pftwin.simulate_batch(batch, parts=None if folder == "-" else folder, **SETTINGS)
        print(f"done {time.process_time() - began}", flush=True)


if __name__ == "__main__":
    member(**json.loads(sys.argv[1]))
