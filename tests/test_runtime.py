"""Settings of the process."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from pftwin import runtime
from pftwin.cli import terminal
from pftwin.errors import InputError
from pftwin.runtime import FAST_CPU, VECTOR_WIDTH, fast_cpu_flags

FAST = f"{VECTOR_WIDTH} --xla_backend_extra_options={','.join(FAST_CPU)}"


def test_fast_cpu_flags_are_added_once():
    assert fast_cpu_flags() == FAST
    assert fast_cpu_flags(FAST) == FAST


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--xla_dump_to=here", f"--xla_dump_to=here {FAST}"),
        ("--xla_cpu_prefer_vector_width=256", FAST.replace("512", "256")),
        ("--xla_backend_extra_options=a", FAST.replace("options=", "options=a,")),
        (
            f"--xla_backend_extra_options={FAST_CPU[1].split('=')[0]}=9",
            FAST.replace(",".join(FAST_CPU), f"{FAST_CPU[1].split('=')[0]}=9,{FAST_CPU[0]}"),
        ),
    ],
)
def test_what_the_user_chose_stays(given, expected):
    assert fast_cpu_flags(given) == expected


def test_xla_takes_the_flags():
    """XLA ends a process that gives it an unknown flag."""
    code = "import os, pftwin; pftwin.configure(); import jax.numpy as jnp; print(float(jnp.ones(2).sum()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.strip() == "2.0", done.stderr


def test_too_late_is_an_error():
    code = "import os; os.environ.pop('XLA_FLAGS', None); import jax; jax.devices(); import pftwin; pftwin.configure()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert "JAX has already computed something" in done.stderr


def test_switches_may_stand_in_any_order(monkeypatch):
    """Those of other people in front, between or behind: nothing has to be switched on any more."""
    words = runtime.fast_cpu_flags("--xla_some_switch=1").split()
    monkeypatch.setenv("XLA_FLAGS", " ".join(reversed(words)))
    monkeypatch.setattr(runtime, "_jax_has_started", lambda: True)
    runtime.configure()
    assert os.environ["XLA_FLAGS"].split() == words[::-1]


@pytest.mark.parametrize(("given", "devices"), [(None, "all"), ("all", "all"), ("3", 3)])
def test_the_command_line_counts_cpu_devices_by_a_variable(monkeypatch, given, devices):
    monkeypatch.delenv("PFTWIN_DEVICES", raising=False)
    if given is not None:
        monkeypatch.setenv("PFTWIN_DEVICES", given)
    asked = {}
    monkeypatch.setattr(runtime, "configure", lambda **settings: asked.update(settings))
    monkeypatch.setitem(sys.modules, "jax", SimpleNamespace(config=SimpleNamespace(values={})))
    terminal.start_computing(batches=True)
    assert asked["cpu_devices"] == devices
    terminal.start_computing()
    assert asked["cpu_devices"] is None


@pytest.mark.parametrize("given", ["0", "-1", "two", ""])
def test_a_variable_that_is_no_number_is_refused(monkeypatch, given):
    monkeypatch.setenv("PFTWIN_DEVICES", given)
    with pytest.raises(InputError, match=r'PFTWIN_DEVICES: found .*; expected: "all", or a whole number, at least 1'):
        terminal.start_computing(batches=True)
