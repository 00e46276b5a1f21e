"""Batches depend neither on the number of devices nor on their order; each number in a process of its own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from elsewhere import elsewhere

from pftwin.base import cache_folder

CHECKS = Path(__file__).with_name("batch_checks.py")
ROUNDING = 1e-9  # as a share: one device and several have programs of their own, by which a contact force is rounded


def seen_with(devices: int) -> dict:
    done = elsewhere(str(CHECKS), str(devices), str(cache_folder.chosen()))
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def with_two() -> dict:
    return seen_with(2)


@pytest.mark.slow
def test_two_devices_give_what_one_gives(with_two):
    assert with_two["devices"] == 2
    assert with_two["padding"] == 130
    with_two["one"].pop("equilibrium_residual")  # rounding itself
    assert {k: v for k, v in with_two["one"].items() if v > ROUNDING} == {}
    for exact in ("status", "status_frames", "recomputed", "failed", "frame_status"):
        assert with_two["one"][exact] == 0


@pytest.mark.slow
def test_the_order_of_members_changes_no_bit(with_two):
    assert with_two["order"]


@pytest.mark.slow
def test_three_devices_give_the_bits_of_two(with_two):
    assert seen_with(3)["bits"] == with_two["bits"]


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "import jax; jax.devices(); pftwin.configure(fast_cpu=False, cpu_devices=2)",
            "has already started with 1",
        ),
        ("from pftwin.dynamics.batch.devices import use_cpu_devices; print('has', use_cpu_devices(3))", "has 3"),
        (
            "pftwin.configure(cpu_devices=2); from pftwin.dynamics.batch import devices; devices.chosen_devices(3)",
            'devices: found 3, where JAX has 2 cpu device(s); expected: "all", or 1 to 2; try: pftwin.configure(cpu_',
        ),
        ("pftwin.configure(cpu_devices=0)", 'cpu_devices: found 0; expected: "all", or a whole number, at least 1'),
    ],
)
def test_cpu_devices_are_counted_before_jax_starts(code, words):
    done = elsewhere("-c", f"import pftwin; {code}")
    assert words in done.stdout + done.stderr
