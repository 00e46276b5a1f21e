"""Runs a cohort of cheap units in forks of one process, which are killed; a Python started for each takes minutes.

Commands on stdin, one a line: "run FOLDER SECONDS" forks a run that SIGKILL ends after so long; "step FOLDER N" one
that SIGKILL ends before its N-th call that changes the file system. The answer is "killed", "ended" or "failed".
Units' beginnings are appended to FOLDER/log.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from cheap_cohort import CheapWork, write_cohort

from fitting.cohort import read_cohort, run_cohort

CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.chmod")  # and "open" for writing, as the interpreter reports them


def run(folder: Path) -> None:
    log = os.open(folder / "log", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    work = CheapWork(began=lambda *unit: os.write(log, f"{' '.join(unit)}\n".encode()) and time.sleep(0.05), size=200)
    run_cohort(read_cohort(folder / "cohort.toml"), resume=True, work=work)


def killed_at(number: int) -> None:
    """Counts the calls that change files, as an audit of the interpreter sees them, without HDF5's own writes."""
    left = [number]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)):
            return
        if event in ("open", *CHANGES):
            left[0] -= 1
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)


def forked(folder: Path, seconds: float | None, step: int | None) -> str:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            if step is not None:
                killed_at(step)
            run(folder)
            code = 0
        finally:
            os._exit(code)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return "killed"
    return "ended" if os.WEXITSTATUS(status) == 0 else "failed"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:  # imports whatever the runs will need
        write_cohort(Path(folder), 1)
        run(Path(folder))
    for line in sys.stdin:
        what, folder, number = line.rstrip("\n").split("\t")
        seconds, step = (float(number), None) if what == "run" else (None, int(number))
        answer = forked(Path(folder), seconds, step)
        sys.stdout.write(answer + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
