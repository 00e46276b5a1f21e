"""A batch over several local processes: one dataset, whatever is lost on the way."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from cheap_batch import ENDED_BY_JAX, UNIT, batch, digest, ended, made_cheap

from pftwin.dynamics.batch.parts import missing_parts, read_parts

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")]


@pytest.fixture
def cheap(monkeypatch):
    return made_cheap(monkeypatch.setattr)


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.parametrize("count", [2, 3])
def test_processes_give_the_dataset_of_one(cheap, tmp_path, count):
    whole = digest(batch())
    calls = [{"parts": str(tmp_path / "parts")}, {"parts": str(tmp_path / "parts")}]
    done = ended(tmp_path / "job", count, calls)
    assert [status for status, _, _ in done] == [0] * count, done
    for i, (_, (first, again), _) in enumerate(done):
        assert first["bits"] == again["bits"] == whole
        assert first["rows"] == [UNIT] * len(range(i, 5, count)), "every process computes its own share"
        assert again["rows"] == []
    assert {p.name for p in (tmp_path / "parts").iterdir()} == {"batch.json", *(f"part_0000{i}.nc" for i in range(5))}
    del cheap.rows[:]
    assert digest(batch(parts=tmp_path / "parts")) == whole
    assert cheap.rows == [], "another number of processes finds the same parts"


def test_what_a_lost_process_left_is_done_by_the_others(cheap, tmp_path):
    """Process 1 of 3 has parts 1 and 4; it dies at the second."""
    done = ended(tmp_path / "job", 3, [{"parts": str(tmp_path / "parts"), "dies": {"1": 1}}], recover=True, wait=3)
    assert [status for status, _, _ in done] == [0, -signal.SIGKILL, 0], done
    for i in (0, 2):
        (said,) = done[i][1]
        assert said["bits"] == digest(batch())
        assert any("process 1 was lost; the others compute the 1 parts it left undone" in w for w in said["warned"])
    assert done[0][1][0]["rows"] == [UNIT] * 3  # 0, 3, and 4 of the lost one's
    assert done[2][1][0]["rows"] == [UNIT]


def test_a_killed_process_ends_the_job_and_costs_no_finished_part(cheap, tmp_path):
    """JAX's own way: silence for longer than its limit ends all, and the same call again does what is missing."""
    began = time.monotonic()
    (first, _, words), (second, _, _) = ended(
        tmp_path / "job", 2, [{"parts": str(tmp_path / "parts"), "dies": {"1": 1}}], wait=5
    )
    assert time.monotonic() - began < 60
    assert (first, second) == (-signal.SIGABRT, -signal.SIGKILL)
    assert ENDED_BY_JAX in words
    assert list(missing_parts(tmp_path / "parts")) == [3]  # process 1 had 1 and 3
    before = contents(tmp_path / "parts")
    assert digest(batch(parts=tmp_path / "parts")) == digest(batch())
    assert cheap.rows[0] == UNIT, "one part alone was computed"
    assert cheap.rows[1:] == [600]
    after = contents(tmp_path / "parts")
    assert {name: after[name] for name in before} == before, "finished parts stay as they are, byte for byte"
    assert digest(read_parts(tmp_path / "parts")) == digest(batch())


def test_refusals_of_several_processes(tmp_path):
    """Every process is told, none waits for the other, and the next call works."""
    calls = [
        {},
        {"foreign": True},
        {"parts": str(tmp_path / "a"), "share": [0, 2]},
        {"parts": str(tmp_path / "a"), "seed": True},
        {"parts": str(tmp_path / "nowhere" / "a")},
        {"parts": str(tmp_path / "own {index}")},
        {"parts": str(tmp_path / "a"), "full": 1},
        {"parts": str(tmp_path / "a"), "full": 0},
    ]
    first, second = ended(tmp_path / "job", 2, calls)
    assert (first[0], second[0]) == (0, 0), (first[2], second[2])
    words = [[line.get("error", "") for line in said] for _, said, _ in (first, second)]
    for said in words:
        assert said[0].startswith("simulate_batch: 2 JAX processes, and no folder in which each could put its part;")
        assert "expected: parts= with a folder that all of them see" in said[0]
        assert "expected: devices of this process, as jax.local_devices() lists them" in said[1]
        assert said[2] == "share: 2 JAX processes share by themselves; try: leave it out"
        assert said[3].startswith(
            "simulate_batch: process 1 has another batch than process 0, with other members; expected: the same call"
        )
        assert "there is no folder" in said[4]
    assert "belongs to process 1, and this is process 0" in words[0][1]
    assert words[1][4].startswith("process 0: ")
    assert words[0][5] == f"process 1: {words[1][5]}"
    assert words[1][5].endswith(
        "own 1: does not contain the batch that process 0 has just prepared; "
        "expected: a folder on a disk shared by all processes"
    )
    assert words[0][6] == f"process 1: {words[1][6]}"
    assert words[1][7] == f"process 0: {words[0][7]}"
    assert "No space left on device" in words[1][6]
    assert [line.get("kind") for line in second[1]][4:] == ["OutputError", "InputError", "OutputError", "OutputError"]
