"""examples/cluster_batch.py as srun starts it, on two local processes with SLURM's variables, and as a job array."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest
from cheap_batch import run_together

from pftwin.base import cache_folder
from pftwin.dynamics.batch.parts import read_parts
from pftwin.files.result_files import load_dataset

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE, PAGE = ROOT / "examples" / "cluster_batch.py", ROOT / "docs" / "batches.md"
FIRST_PORT = 61_440  # of those that JAX takes by the job's number


def free_job() -> int:
    """A job's number whose port is free."""
    for job in range(1, 4_000):
        with socket.socket() as found:
            try:
                found.bind(("127.0.0.1", FIRST_PORT + job))
            except OSError:
                continue
            return job
    raise AssertionError("no free port")


def variables(count: int) -> list[dict[str, str]]:
    common = {
        "SLURM_JOB_ID": str(free_job()),
        "SLURM_STEP_NODELIST": "localhost",
        "SLURM_NTASKS": str(count),
        "PFTWIN_CACHE": str(cache_folder.chosen()),
    }
    return [{**common, "SLURM_PROCID": str(i), "SLURM_LOCALID": str(i)} for i in range(count)]


@pytest.mark.slow
def test_the_example_under_slurm_and_as_a_job_array(toy, tmp_path):
    size = ["--scene", str(toy / "scene.toml"), "--members", "32", "--chunk", "16"]
    together = [str(EXAMPLE), str(tmp_path / "parts"), *size, "-o", str(tmp_path / "found.nc")]
    first, second = run_together(tmp_path, [together, together], environments=variables(2))
    assert (first.status, second.status) == (0, 0), (first.words[-2000:], second.words[-2000:])
    found = load_dataset(tmp_path / "found.nc")
    assert found.sizes["variant"] == 32
    assert found["failed"].sum() < 5  # the toy's patella cannot follow every transfer
    for i in range(2):
        said = (tmp_path / f"{i}.out").read_text()
        assert f"process {i} of 2: 32 members, {int(found['failed'].sum())} failed" in said
        assert f"process {i} of 2: 16 of its 16 members" in said

    before = {p.name: p.read_bytes() for p in (tmp_path / "parts").iterdir()}
    (task,) = run_together(tmp_path, [[*together[:2], *size, "--share", "1", "2"]], environments=variables(1))
    assert task.status == 0, task.words[-2000:]
    assert "process 0 of 1: 16 members" in (tmp_path / "0.out").read_text()
    assert {p.name: p.read_bytes() for p in (tmp_path / "parts").iterdir()} == before, "all was there already"
    done = read_parts(tmp_path / "parts")
    assert done["mean_shift"].values.tobytes() == found["mean_shift"].values.tobytes()


def test_the_page_submits_what_the_example_takes():
    """Options and variables of the job files are those of the script."""
    text, script = PAGE.read_text(), EXAMPLE.read_text()
    jobs = re.findall(r"cluster_batch\.py (.*)", text)
    assert len(jobs) >= 4
    for option in set(re.findall(r"(?<!\S)(--?[a-z]+)", " ".join(jobs))):
        assert f'"{option}"' in script
    for line in ('jax.config.update("jax_enable_recoverability", True)', "jax.distributed.initialize()"):
        assert line in text
        assert line in script
