"""Members keep their places whatever the devices, pieces and chunks: each has an answer of its own."""

from __future__ import annotations

import itertools
import threading
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.dynamics.batch import batched as module
from pftwin.dynamics.batch.batched import PIECE, Sharding, piece_for


@pytest.fixture
def layout(monkeypatch):
    """Spreads over any number of devices: only numbers of places are asked for, no program is run."""
    monkeypatch.setattr(module, "Mesh", lambda devices, axes: SimpleNamespace(size=devices.size))
    return lambda devices, piece, chunk: Sharding(tuple(range(devices)), piece, chunk)


def of_one_device(rows: np.ndarray, counts: np.ndarray, devices: int) -> np.ndarray:
    """What the devices would hand back: 3 times a member's number and 1, nothing where a piece was not run."""
    own = rows.reshape(devices, -1, rows.shape[-1])
    out = np.full(own.shape, -1.0)
    for device, count in enumerate(counts):
        out[device, :count] = 3.0 * own[device, :count] + 1
    return out.reshape(rows.shape)


@pytest.mark.parametrize(
    ("n", "platform", "members"),
    [
        (1, "gpu", 16),
        (17, "gpu", 32),
        (1000, "gpu", 1024),
        (10**6, "gpu", 131_072),
        (32, "cpu", 16),
        (33, "cpu", PIECE),
    ],
)
def test_pieces_come_in_few_sizes(n, platform, members):
    """On an accelerator powers of two from 16 to 131,072, so that few programs are compiled; on a CPU two sizes."""
    assert piece_for(n, platform) == members


@pytest.mark.parametrize(
    ("devices", "piece", "chunk", "n"),
    [*itertools.product((1, 2, 3), (1, 4), (1, 8, 24), (1, 4, 5, 23, 24, 25, 100)), (4, 2, 100, 37)],
)
def test_every_member_gets_its_own_answer(layout, devices, piece, chunk, n):
    spread = layout(devices, piece, chunk)
    seen, done = [], 0

    def work(one: Any) -> np.ndarray:
        assert one.members <= spread.most
        assert one.rows.shape == (spread.most // piece, piece)
        assert one.counts.sum() == -(-one.members // piece)
        assert np.ptp(one.counts) <= 1  # devices are busy alike
        seen.extend(np.unique(one.rows[one.used]))
        return spread.taken(of_one_device(one.rows, one.counts, devices), one)

    def progress(now: int, total: int) -> None:
        nonlocal done
        assert (total, now > done) == (n, True)
        done = now

    np.testing.assert_array_equal(spread.over(work, n, progress=progress), 3.0 * np.arange(n) + 1)
    assert sorted(seen) == list(range(n))
    assert done == n


def test_threads_that_end_out_of_order_change_no_order(layout):
    spread = layout(1, 2, 2)
    later = threading.Event()

    def work(one: Any) -> np.ndarray:
        first = int(one.rows[0, 0])
        if first == 2:
            assert later.wait(20)  # the second chunk ends after the third
        if first == 4:
            later.set()
        return spread.taken(one.rows, one)

    np.testing.assert_array_equal(spread.over(work, 9, threads=3), np.arange(9))


def cubed(shared: Any, row: Any) -> Any:
    return {"cube": row["x"] ** 3 + shared["offset"], "twice": 2 * row["y"]}


def test_the_program_itself_gives_each_member_its_answer():
    spread = Sharding((jax.devices()[0],), 4, 8)
    x = np.random.default_rng(0).normal(size=19)
    each = ({"x": x, "y": np.stack([x, -x], axis=1)},)
    shared = spread.shared({"offset": jnp.asarray(0.5)})
    found = spread.over(lambda c: spread.taken(spread.run(cubed, shared, c, spread.placed(each, c)), c), 19)
    np.testing.assert_allclose(found["cube"], x**3 + 0.5, rtol=1e-14)
    np.testing.assert_array_equal(found["twice"], np.stack([2 * x, -2 * x], axis=1))
