"""Feeds every reader with damaged files: python -m fuzz.run_fuzz --count 1000 (in the folder tests).

Each reader runs in a process of its own, since a library in C may crash. The files of findings are kept.
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from fuzz.judge import little_memory, verdict
from fuzz.mutations import mutated
from fuzz.readers import FORMATS, reader


def _work(name: str, first: int, last: int, findings: str, answers: Any) -> None:
    import pftwin

    pftwin.configure()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        one = reader(name, folder)
        if wrong := verdict(one, one.valid, folder):
            raise SystemExit(f"{name}: the valid file: {wrong}")
        one.read(folder / f"fuzzed{one.suffix}")
        with little_memory():
            for seed in range(first, last):
                answers.send((seed, None))
                content = mutated(one.valid, random.Random(seed))
                if wrong := verdict(one, content, folder):
                    answers.send((seed, wrong))
                    Path(findings, f"{name}_{seed}{one.suffix}").write_bytes(content)
    answers.send((last, "end"))


def fuzz(name: str, first: int, last: int, findings: Path) -> dict[str, list[int]]:
    """What was found, with the seeds of the files."""
    found: dict[str, list[int]] = collections.defaultdict(list)
    context = multiprocessing.get_context("spawn")
    while first < last:
        ours, theirs = context.Pipe(False)
        process = context.Process(target=_work, args=(name, first, last, str(findings), theirs))
        process.start()
        theirs.close()
        done, begun = False, first
        try:
            while True:
                seed, wrong = ours.recv()
                begun = None
                if wrong == "end":
                    done = True
                elif wrong:
                    found[wrong].append(seed)
                first = seed
        except EOFError:
            process.join()
        if done:
            break
        if begun is not None:
            raise SystemExit(f"{name}: the valid file is not read")
        found[f"the process ended: {process.exitcode}"].append(first)
        first += 1
    return found


def main() -> int:
    """Prints what was found; 1 where there is anything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="files for each reader")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--findings", type=Path, default=Path(tempfile.gettempdir()) / "fuzz_findings")
    parser.add_argument("formats", nargs="*", default=FORMATS)
    args = parser.parse_args()
    shutil.rmtree(args.findings, ignore_errors=True)
    args.findings.mkdir(parents=True)
    total = 0
    for name in args.formats:
        began = time.perf_counter()
        found = fuzz(name, args.first, args.first + args.count, args.findings)
        total += len(found)
        print(f"{name}: {args.count} files in {time.perf_counter() - began:.0f} s, {len(found)} findings", flush=True)
        for wrong, seeds in sorted(found.items(), key=lambda item: -len(item[1])):
            print(f"  {len(seeds)} times, first seed {seeds[0]}: {wrong}", flush=True)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
