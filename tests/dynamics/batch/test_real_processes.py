"""The motions that two and three processes compute are those of one, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cheap_batch import Ended, free_port, run_together

from pftwin.base import cache_folder

SCRIPT = Path(__file__).with_name("real_processes.py")


def seen(folder: Path, count: int) -> list[Ended]:
    port, cache = free_port(), str(cache_folder.chosen())
    commands = [[str(SCRIPT), str(i), str(count), str(port), str(folder / "parts"), cache] for i in range(count)]
    return run_together(folder, commands)


@pytest.fixture(scope="module")
def of_one(tmp_path_factory) -> dict:
    (done,) = seen(tmp_path_factory.mktemp("one"), 1)
    assert done.status == 0, done.words[-2000:]
    return done.printed[0]


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_processes_give_the_bits_of_one(of_one, tmp_path, count):
    for i, done in enumerate(seen(tmp_path, count)):
        assert done.status == 0, done.words[-2000:]
        assert done.printed[0]["bits"] == of_one["bits"]
        assert done.printed[0]["alone"] == of_one["alone"], "a kept program runs on a process's own device"
        assert done.printed[0]["done"] == [120 * (k + 1) for k in range(len(range(i, 5, count)))]
    assert json.loads((tmp_path / "parts" / "batch.json").read_text())["units"] == [120] * 5
