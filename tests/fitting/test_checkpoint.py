"""What a search has so far, written and read again: the same numbers, in the same shapes."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.methods.problem import load_checkpoint, save_checkpoint
from pftwin.base.errors import InputError

RANDOM = np.random.default_rng(0)
STATE = {
    "points": RANDOM.normal(size=(2, 3)) / 3,
    "alive": np.array([True, False]),
    "best": np.float64(0.1) + np.float64(0.2),
    "generation": np.int64(7),
    "history": [{"best": np.float64(1 / 3), "evaluations": 12}, {"best": -np.inf, "evaluations": 24}],
    "sizes": (3, np.int64(4)),
    "inner": {"random": {"state": {"state": 2**100 + 1, "name": "PCG64"}}},
    "stopped": None,
}


def test_a_state_is_read_as_it_was_written(tmp_path):
    save_checkpoint(tmp_path / "state.json", "this one", STATE)
    found = load_checkpoint(tmp_path / "state.json", "this one")
    assert found.keys() == STATE.keys()
    for name in ("points", "alive"):
        np.testing.assert_array_equal(found[name], STATE[name])
        assert found[name].dtype == STATE[name].dtype
    rest = {k: found[k] for k in STATE if k not in ("points", "alive")}
    assert rest == {
        "best": 0.30000000000000004,
        "generation": 7,
        "history": [{"best": 1 / 3, "evaluations": 12}, {"best": -np.inf, "evaluations": 24}],
        "sizes": [3, 4],
        "inner": {"random": {"state": {"state": 2**100 + 1, "name": "PCG64"}}},
        "stopped": None,
    }


def test_that_of_another_problem_is_refused(tmp_path):
    save_checkpoint(tmp_path / "state.json", "this one", STATE)
    with pytest.raises(InputError, match="a checkpoint of another problem"):
        load_checkpoint(tmp_path / "state.json", "another")
