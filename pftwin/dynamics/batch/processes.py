"""Several processes of one job, as `jax.distributed` joins them: who is there, and what they tell each other.

They meet by `live_devices`, which goes by every process's heartbeats: a meeting waits for whoever lives, however long,
and for nobody else. A collective alone would do neither: Gloo's gives up after half an hour, and none goes on without a
process that died. So texts are exchanged by a collective among the CPUs of those who have just met.
"""

from __future__ import annotations

import atexit
import contextlib
from functools import cache
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

# What `live_devices` raises where a process was lost in its block: until JAX 0.10.0 the one, then the other.
_LOST = (ValueError, getattr(multihost_utils, "ProcessFailureError", ValueError))


class Processes:
    """The processes that work on one batch; without `jax.distributed` this one alone."""

    def __init__(self) -> None:
        self.index, self.count = jax.process_index(), jax.process_count()
        self.alive = tuple(range(self.count))
        if self.count > 1 and self.index == 0:
            _last_to_leave()

    def gathered(self, text: str) -> dict[int, str]:
        """What each process that is still there has to say, by its index. Waits for all of them.

        From then on `alive` are those: all processes agree on it.
        """
        if self.count == 1:
            return {self.index: text}
        live = _barrier()
        while True:
            failure, said = None, {}
            try:
                said = _gather_texts(live, text)
            except jax.errors.JaxRuntimeError as error:
                failure = error
            before, live = live, _barrier()
            if live == before:  # otherwise one was lost meanwhile, and the others talk again
                if failure is not None:
                    raise failure
                self.alive = tuple(said)
                return said


def _barrier() -> dict[int, Any]:
    """Waits for all processes that live: a CPU device of each, by its index, the same for all who have met."""
    while True:
        found = multihost_utils.live_devices(jax.devices("cpu"))
        if isinstance(found, list):  # before JAX 0.8.1
            break
        with contextlib.suppress(*_LOST):  # a context, which meets as its block ends, and says so if one was lost
            with found as devices:
                pass
            found = devices
            break
    first = {d.process_index: d for d in sorted(found, key=lambda d: d.id, reverse=True)}
    return {i: first[i] for i in sorted(first)}


def _gather_texts(devices: dict[int, Any], text: str) -> dict[int, str]:
    """Each process's text, by its index."""
    own = np.frombuffer(text.encode(), np.uint8)
    sizes = _rows(devices, np.array([own.size], np.int32))[:, 0]
    padded = np.zeros(sizes.max(), np.uint8)
    padded[: own.size] = own
    rows = _rows(devices, padded)
    return {i: row[:n].tobytes().decode() for i, row, n in zip(devices, rows, sizes, strict=True)}


def _rows(devices: dict[int, Any], row: np.ndarray) -> np.ndarray:
    """The rows of all processes, in the order of the devices; all are of one length."""
    mesh = Mesh(np.array(list(devices.values())), ("process",))
    rows = jax.make_array_from_process_local_data(NamedSharding(mesh, PartitionSpec("process")), row[None])
    everywhere = jax.jit(lambda x: x, out_shardings=NamedSharding(mesh, PartitionSpec()))(rows)
    return np.asarray(everywhere.addressable_data(0))


@cache
def _last_to_leave() -> None:
    """The coordination service lives in process 0, and who is still there when it goes is ended.

    JAX itself has processes leave together, but not where they may outlive each other (jax_enable_recoverability).
    """
    if getattr(jax.config, "jax_enable_recoverability", False):
        atexit.register(_barrier)
