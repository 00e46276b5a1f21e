"""Whoever changes a constant or a function that a program looks up gets another program."""

from __future__ import annotations

import os
import time

import pytest

import pftwin
from pftwin.dynamics import equilibrium, integrators, trajectory
from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.dynamics.simulate import simulate
from pftwin.effects.gravity import Gravity
from pftwin.kept import reach as module
from pftwin.kept.identity import CannotKeepError
from pftwin.kept.reach import reach, source


def test_a_constant_behind_a_custom_derivative_is_reached(monkeypatch):
    before = reach(starting_equilibrium)
    assert reach(starting_equilibrium) == before
    monkeypatch.setattr(equilibrium, "REACH", 1.5 * equilibrium.REACH)
    assert reach(starting_equilibrium) != before


def test_a_function_replaced_by_another_of_pftwin_is_another_program(monkeypatch):
    before = reach(trajectory.trajectory)
    euler = integrators.INTEGRATORS["symplectic_euler"]
    monkeypatch.setitem(integrators.INTEGRATORS, "linear_implicit", euler)
    assert reach(trajectory.trajectory) != before


def test_functions_from_elsewhere_are_refused(monkeypatch):
    mine = integrators.INTEGRATORS["linear_implicit"]._replace(advance=lambda *_: None)
    monkeypatch.setitem(integrators.INTEGRATORS, "mine", mine)
    with pytest.raises(CannotKeepError, match="test_reach"):
        reach(trajectory.trajectory)


def test_a_replaced_method_is_refused(monkeypatch):
    reach(Gravity)
    monkeypatch.setattr(Gravity, "load", lambda self, now, memory: None)
    with pytest.raises(CannotKeepError, match="test_reach"):
        reach(Gravity)


def test_everything_that_simulate_reaches_is_known():
    assert "pftwin.dynamics.integrators.linear_implicit.linear_implicit" in reach(simulate)


def test_source_that_is_newer_than_the_process_is_refused(monkeypatch):
    monkeypatch.setattr(pftwin, "imported_at", 0.0)
    with pytest.raises(CannotKeepError, match="changed after this process began"):
        source()


def test_the_hash_follows_the_source(monkeypatch, tmp_path):
    monkeypatch.setattr(pftwin, "__path__", [str(tmp_path)])
    monkeypatch.setattr(pftwin, "imported_at", time.time() + 60)
    hashes = []
    for name, text in (("a.py", "x = 1\n"), ("a.py", "x = 2\n"), ("b.py", "x = 2\n")):
        for old in tmp_path.iterdir():
            os.remove(old)
        (tmp_path / name).write_text(text)
        module._source_hash.cache_clear()
        hashes.append(source())
    module._source_hash.cache_clear()
    assert len(set(hashes)) == 3


def test_no_source_is_a_refusal(monkeypatch, tmp_path):
    monkeypatch.setattr(pftwin, "__path__", [str(tmp_path)])
    with pytest.raises(CannotKeepError, match="cannot be read"):
        source()
