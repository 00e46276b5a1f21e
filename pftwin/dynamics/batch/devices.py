"""The devices that a batch uses. JAX counts a whole CPU as one device unless it is configured before it starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax

from pftwin.base.errors import InputError
from pftwin.base.runtime import configure, cores

Devices = str | int | Sequence[Any]


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
            _check_own(listed)
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


def _check_own(devices: Sequence[Any]) -> None:
    for device in devices:
        if device.process_index != jax.process_index():
            raise InputError(
                f"{device} belongs to process {device.process_index}, and this is process {jax.process_index()}",
                where="devices",
                expected="devices of this process, as jax.local_devices() lists them",
                remedy='devices="all"',
            )
