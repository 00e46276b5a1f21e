"""SIGKILL at any moment: a finished file stays as it is, and at most the unit in flight is lost."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from cheap_cohort import CheapWork, cheap, write_cohort

from fitting.cohort import read_cohort, run_cohort
from fitting.cohort.folder import check_cohort
from fitting.cohort.manifest import Manifest, file_digest, file_fault

HERE = Path(__file__).resolve().parent
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


class Server:
    """`kill_server.py`, and what it has done to a folder."""

    def __init__(self) -> None:
        places = (HERE.parents[2], HERE.parents[1], HERE)
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(str(p) for p in places)}
        self.process = subprocess.Popen(
            [sys.executable, "-W", "ignore", str(HERE / "kill_server.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env,
        )

    def __call__(self, what: str, folder: Path, number: float) -> str:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{what}\t{folder}\t{number}\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(60)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    started = Server()
    yield started
    started.close()


class Watched:
    """A cohort's folder between kills."""

    def __init__(self, folder: Path, patients: int) -> None:
        folder.mkdir(exist_ok=True)
        write_cohort(folder, patients)
        self.cohort = read_cohort(folder / "cohort.toml")
        self.folder, self.log = folder, folder / "log"
        self.finished: dict[str, str] = {}
        self.begun = 0
        self.lost = 0

    def look(self) -> None:
        """Judges what a kill has left."""
        begun = len(self.log.read_text().splitlines()) if self.log.exists() else 0
        place = self.cohort.output
        manifest = (
            Manifest.load(place) if (place / "manifest.json").exists() else Manifest(self.cohort.name, {}, {}, None)
        )
        for name, entry in manifest.files.items():
            assert file_fault(entry, place / name) is None, name
        now = {name: entry.sha256 for name, entry in manifest.files.items()}
        assert self.finished.items() <= now.items(), "a finished file was written again or forgotten"
        lost = (begun - self.begun) - (len(now) - len(self.finished))
        assert 0 <= lost <= 1, "more than the unit in flight was lost"
        assert manifest.failures == {}
        if (place / "manifest.json").exists():
            assert {f.verdict for f in check_cohort(self.cohort)} <= {"sound", "not there yet", "out of date"}
        if (summary := place / "summary.parquet").exists():
            import pyarrow.parquet as parquet

            assert parquet.read_table(summary)["patient"].to_pylist()
        self.finished, self.begun, self.lost = now, begun, self.lost + lost

    def as_without_kills(self) -> None:
        """The same summary as a run in peace, nothing unfinished beside it."""
        self.look()
        assert {f.verdict for f in check_cohort(self.cohort)} == {"sound"}
        digest, units, names = in_peace(len(self.cohort.patients))
        assert file_digest(self.cohort.output / "summary.parquet") == digest
        assert units + self.lost == self.begun
        assert {p.name for p in self.cohort.output.rglob("*") if p.is_file()} == names


@cache
def in_peace(patients: int) -> tuple[str, int, set[str]]:
    """Summary's checksum, number of units and names of files of a run that nobody kills."""
    with tempfile.TemporaryDirectory() as folder:
        work = CheapWork(size=200)
        output = run_cohort(cheap(Path(folder), patients), work=work).folder
        return (
            file_digest(output / "summary.parquet"),
            len(work.ran),
            {p.name for p in output.rglob("*") if p.is_file()},
        )


def killed_at_steps(server: Server, folder: Path, patients: int, steps: Iterator[int]) -> tuple[int, int]:
    """Each step of a run on an empty folder, then what remains is computed; numbers of kills and of lost units."""
    kills = lost = 0
    for step in steps:
        watched = Watched(folder / f"{step}", patients)
        answer = server("step", watched.folder, step)
        if answer == "ended":
            break
        assert answer == "killed"
        kills += 1
        watched.look()
        assert server("step", watched.folder, 10**6) == "ended"
        watched.as_without_kills()
        lost += watched.lost
    return kills, lost


@pytest.mark.slow
def test_killed_between_the_writes_of_a_unit(server, tmp_path):
    """Some of the moments that the slow test takes one after the other."""
    kills, _ = killed_at_steps(server, tmp_path, 1, iter((3, 12, 21)))
    assert kills == 3


@pytest.mark.slow
def test_killed_before_every_change_of_the_file_system(server, tmp_path):
    kills, lost = killed_at_steps(server, tmp_path, 1, iter(range(1, 1000)))
    print(f"{kills} kills, {lost} units lost")
    assert 30 < kills < 200
    assert 0 < lost <= kills


@pytest.mark.slow
def test_killed_at_20_random_moments(server, tmp_path):
    chance, kills, lost, round_ = random.Random(7), 0, 0, 0
    began = time.perf_counter()
    server("step", Watched(tmp_path / "first", 4).folder, 10**6)
    whole = time.perf_counter() - began
    while kills < 20:
        watched, round_ = Watched(tmp_path / f"{round_}", 4), round_ + 1
        while kills < 20:
            answer = server("run", watched.folder, chance.uniform(0, 0.8 * whole))
            assert answer in ("killed", "ended")
            if answer == "ended":
                break
            kills += 1
            watched.look()
        assert server("step", watched.folder, 10**6) == "ended"
        watched.as_without_kills()
        lost += watched.lost
    print(f"{kills} kills in {round_} cohorts, {lost} units lost")
    assert kills == 20


def test_the_next_run_clears_what_was_left(tmp_path):
    cohort = cheap(tmp_path, 1)
    run_cohort(cohort, work=CheapWork())
    left = [
        ".manifest.abcd_123.json",
        ".summary.abcdefgh.parquet",
        "patients/.A.abcdefgh.nc",
        "patients/.room.12345678.nc",
    ]
    mine = [".notes.txt", "patients/.A.nc", ".A.abcdefgh.nc"]
    for name in (*left, *mine):
        (cohort.output / name).write_text("x")
    run_cohort(cohort, resume=True, work=CheapWork())
    assert [n for n in (*left, *mine) if (cohort.output / n).exists()] == mine


def test_the_manifest_announces_the_summary_before_it_is_written(tmp_path, monkeypatch):
    """Killed between the two, the old summary is known for what it is."""
    cohort = cheap(tmp_path, 2)

    class KilledError(BaseException):
        pass

    import fitting.cohort.summary as module

    real, calls = module.written_whole, []

    def killed(path):
        calls.append(path)
        if len(calls) == 2:
            raise KilledError
        return real(path)

    monkeypatch.setattr(module, "written_whole", killed)
    with pytest.raises(KilledError):
        run_cohort(cohort, work=CheapWork())
    assert {f.file: f.verdict for f in check_cohort(cohort)}["summary.parquet"] == "out of date"
    announced = json.loads((cohort.output / "manifest.json").read_text())["summary"]
    assert announced["before"] == file_digest(cohort.output / "summary.parquet") != announced["sha256"]
