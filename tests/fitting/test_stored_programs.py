"""Programs of fits are stored for the next process, so that it need not trace them."""

from __future__ import annotations

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lifted_fits import SPRINGS
from small_scene import hanging_scene

import fitting
from fitting import programs
from pftwin.base import cache_folder, program_cache
from pftwin.base.program_cache import Program


@pytest.fixture
def programs_folder(tmp_path):
    before = cache_folder.chosen()
    cache_folder.use_cache_folder(tmp_path / "cache")
    yield tmp_path / "cache" / "programs"
    cache_folder.use_cache_folder(before)


@pytest.mark.slow
def test_another_process_does_not_trace_stored_programs(programs_folder, monkeypatch):
    scene = hanging_scene(6)
    free = fitting.free_parameters(scene, SPRINGS)
    theta = jnp.asarray(free.nominal * np.linspace(0.95, 1.05, 3)[:, None])
    guesses = jax.tree.map(lambda a: jnp.broadcast_to(a, (3,)), scene.start)
    traced = []

    def predicted(*args):
        traced.append(args)
        return original(*args)

    original = programs._predicted  # what the programs trace
    monkeypatch.setattr(programs, "_predicted", predicted)

    def run(channel: str) -> list:
        """As a new process: an instance of `Program` starts with nothing compiled."""
        program = Program(inspect.unwrap(programs.predictions))
        args = programs.FitProgram(free.places, (channel,), None), scene.unnamed(), jnp.asarray(2), theta, guesses
        return jax.tree.leaves(program(*args))

    first, count = run("position"), len(traced)
    again = run("position")
    assert count > 0
    assert len(traced) == count
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert run("quadriceps")[0].shape == (3, 6, 1)  # another program, which is traced
    assert len(traced) > count
    assert len(list(programs_folder.iterdir())) == 2
    count = len(traced)
    source = program_cache._source
    monkeypatch.setattr(program_cache, "_source", lambda package: source(package) + package.removeprefix("pftwin"))
    run("position")  # after a change of fitting alone
    assert len(traced) > count
