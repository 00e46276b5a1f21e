"""Devices that a batch uses, and communication between the processes that compute it.

JAX treats a whole CPU as one device unless configured otherwise before it starts.
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
# Errors of `live_devices` when a process is lost in its block: the first until JAX 0.10.0, then the second.
_LOST = (ValueError, getattr(multihost_utils, "ProcessFailureError", ValueError))


def use_cpu_devices(count: int | None = None) -> int:
    """Divides the CPU into several JAX devices, one core each. Call it before the first JAX computation.

    Args:
        count: number of devices; None: the number of cores that this process may use.

    Returns:
        The number of CPU devices.

    Raises:
        PftwinError: JAX has already started with another number.
        InputError: `count` is not a positive integer.
    """
    configure(float64=False, fast_cpu=False, cpu_devices="all" if count is None else count)
    return len(jax.local_devices(backend="cpu"))


def chosen_devices(devices: Devices = "all") -> tuple[Any, ...]:
    """Resolves a choice of devices to devices of this process; each process uses only its own.

    Args:
        devices: "all" devices of JAX's default platform, the number of devices to use, or devices of one platform.

    Raises:
        InputError: another value, more devices than there are, or a device of another process.
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
    """Number of threads that dispatch to the devices: one per core if "all" is a single CPU device, else one.

    With several processes it is one each, since it is unknown which cores belong to which process.
    """
    whole = isinstance(devices, str) and [d.platform for d in chosen_devices(devices)] == ["cpu"]
    return cores() if whole and jax.process_count() == 1 else 1


class Processes:
    """The processes of `jax.distributed` that compute one batch, or this process alone.

    They synchronise by `live_devices`, which relies on heartbeats: it waits for every live process without a timeout,
    and not for dead ones. A collective alone would do neither: Gloo's times out after half an hour, and none continues
    without a dead process. So texts are exchanged by a collective among the CPUs of the processes that are alive.
    """

    def __init__(self) -> None:
        self.index, self.count = jax.process_index(), jax.process_count()
        self.alive = tuple(range(self.count))
        if self.count > 1 and self.index == 0:
            _last_to_leave()

    def gathered(self, text: str) -> dict[int, str]:
        """Exchanges texts: waits for all live processes and returns the text of each, by its index.

        Also sets `alive` to these processes; all processes agree on it.
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
            if live == before:  # otherwise a process was lost meanwhile, and the others repeat the exchange
                if failure is not None:
                    raise failure
                self.alive = tuple(said)
                return said


def _barrier() -> dict[int, Any]:
    """Waits for all live processes; returns a CPU device of each by its index, the same in all processes."""
    while True:
        with contextlib.suppress(*_LOST):  # the block's end synchronises, and raises an error if a process was lost
            with multihost_utils.live_devices(jax.devices("cpu")) as found:
                pass
            break
    first = {d.process_index: d for d in sorted(found, key=lambda d: d.id, reverse=True)}
    return {i: first[i] for i in sorted(first)}


def _gather_texts(devices: dict[int, Any], text: str) -> dict[int, str]:
    """Text of each process, by its index."""
    own = np.frombuffer(text.encode(), np.uint8)
    sizes = _rows(devices, np.array([own.size], np.int32))[:, 0]
    padded = np.zeros(sizes.max(), np.uint8)
    padded[: own.size] = own
    rows = _rows(devices, padded)
    return {i: row[:n].tobytes().decode() for i, row, n in zip(devices, rows, sizes, strict=True)}


def _rows(devices: dict[int, Any], row: np.ndarray) -> np.ndarray:
    """Rows of all processes, in the order of the devices; all have the same length."""
    mesh = Mesh(np.array(list(devices.values())), ("process",))
    rows = jax.make_array_from_process_local_data(NamedSharding(mesh, PartitionSpec("process")), row[None])
    everywhere = jax.jit(lambda x: x, out_shardings=NamedSharding(mesh, PartitionSpec()))(rows)
    return np.asarray(everywhere.addressable_data(0))


@cache
def _last_to_leave() -> None:
    """Makes process 0, which runs the coordination service, exit last: its exit ends all other processes.

    JAX itself makes processes exit together, except with jax_enable_recoverability.
    """
    if getattr(jax.config, "jax_enable_recoverability", False):
        atexit.register(_barrier)
