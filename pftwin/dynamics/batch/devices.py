"""The devices that a batch uses, and the processes that work on it.

JAX counts a whole CPU as one device unless it is configured before it starts.
"""

from __future__ import annotations

import atexit
import contextlib
from collections.abc import Sequence
from functools import cache
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from pftwin.base.errors import InputError
from pftwin.base.runtime import configure, cores

Devices = str | int | Sequence[Any]
# What `live_devices` raises where a process was lost in its block: until JAX 0.10.0 the one, then the other.
_LOST = (ValueError, getattr(multihost_utils, "ProcessFailureError", ValueError))


def use_cpu_devices(count: int | None = None) -> int:
    """Has JAX count the CPU as several devices, one core each. Call it before the first JAX computation.

    Args:
        count: how many; None: as many as there are cores for this process.

    Returns:
        How many there are now.

    Raises:
        PftwinError: JAX has already started with another number.
        InputError: not a whole number, at least 1.
    """
    configure(float64=False, fast_cpu=False, cpu_devices="all" if count is None else count)
    return len(jax.local_devices(backend="cpu"))


def chosen_devices(devices: Devices = "all") -> tuple[Any, ...]:
    """The devices that are meant, of this process: each of several processes lays its own members over its own devices.

    Args:
        devices: "all" of JAX's default kind, the first so many of them, or a list of devices of one kind.

    Raises:
        InputError: none of these, more devices than there are, or a device of another process.
    """
    there = jax.local_devices()
    if isinstance(devices, str) and devices == "all":
        return tuple(there)
    if isinstance(devices, int) and not isinstance(devices, bool):
        if devices > len(there):
            raise InputError(
                f"found {devices}, where JAX has {len(there)} {there[0].platform} device(s)",
                where="devices",
                expected=f'"all", or 1 to {len(there)}',
                remedy=f"pftwin.configure(cpu_devices={devices}) before any other use of JAX; or PFTWIN_DEVICES="
                f"{devices} for the command line"
                if there[0].platform == "cpu"
                else "fewer devices",
            )
        if devices >= 1:
            return tuple(there[:devices])
    elif isinstance(devices, Sequence) and not isinstance(devices, str):
        listed = tuple(devices)
        kinds = {d.platform for d in listed if isinstance(d, jax.Device)}
        if listed and all(isinstance(d, jax.Device) for d in listed) and len(kinds) == 1:
            for device in listed:
                if device.process_index != (here := jax.process_index()):
                    raise InputError(
                        f"{device} belongs to process {device.process_index}, and this is process {here}",
                        where="devices",
                        expected="devices of this process, as jax.local_devices() lists them",
                        remedy='devices="all"',
                    )
            if len(set(listed)) == len(listed):
                return listed
            raise InputError("one device is named twice", where="devices", expected="different devices")
    raise InputError(
        f"found {devices!r}", where="devices", expected='"all", a number of devices, or JAX devices of one kind'
    )


def feeding_threads(devices: Devices) -> int:
    """How many threads may feed the devices that are meant: all cores where "all" is a CPU that JAX takes for one.

    Each of several processes gets one: which cores belong to which process is unknown here.
    """
    whole = isinstance(devices, str) and [d.platform for d in chosen_devices(devices)] == ["cpu"]
    return cores() if whole and jax.process_count() == 1 else 1


class Processes:
    """The processes that work on one batch, as `jax.distributed` joins them; without it this one alone.

    They meet by `live_devices`, which goes by every process's heartbeats: a meeting waits for whoever lives, however
    long, and for nobody else. A collective alone would do neither: Gloo's gives up after half an hour, and none goes on
    without a process that died. So texts are exchanged by a collective among the CPUs of those who have just met.
    """

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
        with contextlib.suppress(*_LOST):  # a context, which meets as its block ends, and says so if one was lost
            with multihost_utils.live_devices(jax.devices("cpu")) as found:
                pass
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
