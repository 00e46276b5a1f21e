"""Methods beside least squares; fits that are interrupted or killed go on as if nothing had happened."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from lifted_fits import FEW, SPRINGS, clean, scene, truth

import fitting
import fitting.fit
from fitting.methods.populations import Genetic
from fitting.methods.problem import Problem
from fitting.objective import Objective
from pftwin.base import cache_folder
from pftwin.model.measured import Measured


def test_genetic_batches_have_one_size():
    problem = Problem.of([scene()], [fitting.free_parameters(scene(), SPRINGS)], Objective.of(scene(), clean()))
    search = Genetic(problem, 0, populations=3)
    problem.evaluator.prepare(search.widest)
    assert problem.evaluator.chunk == 75  # one call a core


@pytest.mark.parametrize("method", [pytest.param("cma_es", marks=pytest.mark.slow), "differential_evolution"])
@pytest.mark.slow
def test_strategies_find_it_and_repeat_themselves(method):
    pytest.importorskip("evosax")
    one, other = (
        fitting.fit_tendons(scene(), clean(), method=method, population=24, generations=40, seed=1) for _ in "ab"
    )
    np.testing.assert_array_equal(one.values, other.values)
    assert one.history[-1]["best"] < one.history[0]["best"] - 20


@pytest.mark.slow
def test_gradients_find_it():
    found = fitting.fit_tendons(scene(), clean(), method="gradient", starts=8, iterations=60)
    assert found.rmse["position"] < 2e-5


@pytest.mark.slow
def test_an_interrupt_keeps_the_best_and_can_be_resumed(tmp_path):
    def interrupt(p):
        if p.iteration == 3:
            raise KeyboardInterrupt

    path = tmp_path / "state.json"
    part = fitting.fit_tendons(scene(), clean(), progress=interrupt, checkpoint=path, **FEW)
    assert part.reason == "interrupted; the best so far"
    assert part.iterations == 3
    whole = fitting.fit_tendons(scene(), clean(), **FEW)
    resumed = fitting.fit_tendons(scene(), clean(), checkpoint=path, resume=True, **FEW)
    np.testing.assert_array_equal(resumed.values, whole.values)
    assert resumed.history == whole.history


_KILLED = """
import sys, time
from pathlib import Path
sys.path[:0] = {paths!r}
from pftwin.base.runtime import configure
configure(cache_dir={cache!r})
import numpy as np, fitting, fitting.fit
from lifting_scene import lifting_scene
from small_scene import small_scene
from pftwin.model.measured import Measured
fitting.fit._BETWEEN_CHECKPOINTS = 0.0
data = np.load({data!r})
fitting.fit_tendons(lifting_scene(), Measured(data["t"], data["c"]), method="genetic", generations=12, population=24,
                    checkpoint=Path({checkpoint!r}), progress=lambda p: time.sleep(0.2))
"""


class _Gone(BaseException):
    """What no part of a fit waits for: like the end of the process, it leaves what is on disk, and no more."""


@pytest.mark.slow
def test_a_killed_fit_resumes_with_the_same_result(tmp_path, monkeypatch):
    def end(p):
        if p.iteration == 5:
            raise _Gone

    path = tmp_path / "state.json"
    options = {"method": "genetic", "generations": 12, "population": 24}
    monkeypatch.setattr(fitting.fit, "_BETWEEN_CHECKPOINTS", 0.0)
    with pytest.raises(_Gone):
        fitting.fit_tendons(scene(), clean(), checkpoint=path, progress=end, **options)
    assert json.loads(path.read_text())["state"]["iteration"] == 5
    resumed = fitting.fit_tendons(scene(), clean(), checkpoint=path, resume=True, **options)
    whole = fitting.fit_tendons(scene(), clean(), **options)
    assert resumed.history == whole.history
    np.testing.assert_array_equal(resumed.values, whole.values)
    assert whole.reason == "12 generations, the most allowed"
    assert whole.evaluations == 24 + 12 * 24


@pytest.mark.slow
def test_a_killed_process_leaves_what_can_be_resumed(tmp_path):

    data, path = tmp_path / "data.npz", tmp_path / "state.json"
    np.savez(data, t=truth().times, c=truth().center)
    here = Path(__file__).parent
    paths = [str(here), str(here.parent), str(here.parents[1])]
    cache = str(cache_folder.chosen())
    code = _KILLED.format(paths=paths, cache=cache, data=str(data), checkpoint=str(path))
    child = subprocess.Popen([sys.executable, "-c", code], env=os.environ.copy())
    try:
        deadline = time.monotonic() + 280
        while child.poll() is None and time.monotonic() < deadline:
            if path.exists() and json.loads(path.read_text())["state"]["iteration"] >= 4:
                break
            time.sleep(0.05)
        assert child.poll() is None
        os.kill(child.pid, signal.SIGKILL)
    finally:
        child.kill()
        child.wait()
    reached = json.loads(path.read_text())["state"]["iteration"]
    assert 4 <= reached < 13
    options = {"method": "genetic", "generations": 12, "population": 24}
    data = Measured(truth().times, truth().center)
    resumed = fitting.fit_tendons(scene(), data, checkpoint=path, resume=True, **options)
    whole = fitting.fit_tendons(scene(), data, **options)
    assert resumed.history == whole.history
    np.testing.assert_array_equal(resumed.values, whole.values)
    assert whole.reason == "12 generations, the most allowed"
    assert whole.evaluations == 24 + 12 * 24
