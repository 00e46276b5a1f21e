"""A batch on an accelerator is the batch on the CPU, in either float type."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import pytest
from elsewhere import elsewhere

from pftwin.base import cache_folder
from tests.benchmarks import accelerator

CHECKS = Path(__file__).with_name("accelerator_checks.py")
# As shares of each variable's own size, set before there was an accelerator to try them on. In float32 a stiff contact
# knows its indentation to a part in a thousand.
ROUNDING = {"float64": 1e-7, "float32": 2e-2}


def platforms() -> set[str]:
    """Of accelerators that JAX knows here."""
    found = set()
    for name in ("gpu", "tpu"):
        try:
            found |= {d.platform for d in jax.devices(name)}
        except RuntimeError:  # JAX's way to say that there is none
            continue
    return found


@pytest.mark.parametrize(("precision", "contact"), [("float64", "patch"), ("float32", "patch"), ("float64", "volume")])
@pytest.mark.parametrize("there", [pytest.param("cpu", marks=pytest.mark.slow), "gpu"])
def test_it_gives_what_a_cpu_gives(there, precision, contact):
    """Slow, and on any machine: a CPU beside itself, that is, that the comparison runs and finds nothing."""
    if there == "gpu" and not platforms():
        pytest.skip("JAX has no accelerator here: pip install -e '.[cuda]' on a machine that has one")
    cache = str(cache_folder.chosen())
    done = elsewhere(str(CHECKS), there, precision, cache, contact)
    assert done.returncode == 0, done.stderr[-2000:]
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["dtype"] == precision
    assert seen["status"] == 0
    assert {k: v for k, v in seen["differences"].items() if v > ROUNDING[precision]} == {}


def test_without_one_nothing_is_measured_and_that_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(accelerator, "has_one", lambda: False)
    accelerator.work({"precision": "float64", "quick": True}, tmp_path / "rows.json")
    assert json.loads((tmp_path / "rows.json").read_text()) == []
    assert "no accelerator here" in capsys.readouterr().err


@pytest.mark.slow
def test_figures_are_taken_on_any_device():
    import pftwin

    rows = list(accelerator.rows(pftwin.rig.case(2, contact="P5"), (1,)))
    assert all(row.value > 0 for row in rows)
    assert [row.unit for row in rows] == ["1/s", "times", "1/s", "times", "ms", "ms", "ms"]
