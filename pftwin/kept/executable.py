"""Compiled programs for one CPU device as bytes: the compiler's own, and what its answers are.

`jax.experimental.serialize_executable` pickles. Here the client of XLA is asked for the executable's bytes, as JAX does
for its compilation cache. They are machine code nevertheless: whoever can write to the folder they lie in can run code,
with or without pickle, which is why `folder` takes nothing from a folder that others can write to. Portable programs
(`jax.export`) would be data alone but have to be compiled in every process: 16 s for the rig's first case, against 1 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.core import ShapedArray

from pftwin.kept.identity import CannotKeepError
from pftwin.kept.plain import packed, unpacked


def written(compiled: Any, answers: Sequence[Any], text: str) -> bytes:
    """A program compiled from `text`, which takes all its arguments (`keep_unused`) and gives these shapes.

    Raises:
        CannotKeepError: it calls back into Python, or this version of JAX cannot write programs down.
    """
    if "callback" in text:  # it holds the address of something in this process
        raise CannotKeepError("a program that calls back into Python")
    try:
        executable = compiled.runtime_executable()
        body = executable.client.serialize_executable(executable)
    except Exception as error:
        raise CannotKeepError(f"a program that cannot be written down: {error}") from error
    kinds = [[list(a.shape), a.dtype.str, bool(a.weak_type)] for a in answers]
    return packed((kinds, np.frombuffer(body, np.uint8)))


def loaded(body: bytes) -> Callable[..., list[Any]]:
    """The program, from arrays to a list of arrays as the compiled function would give them.

    Raises:
        Exception: whatever XLA says of bytes that are no program for this machine.
    """
    from jaxlib._jax import array_result_handler
    from jaxlib.xla_client import DeviceList

    answers, code = unpacked(body)
    device = jax.local_devices()[0]  # of several processes each has its own
    executable = device.client.deserialize_executable(code.tobytes(), executable_devices=DeviceList((device,)))
    place = jax.sharding.SingleDeviceSharding(device)
    handlers = [
        array_result_handler(
            ShapedArray(tuple(shape), np.dtype(kind), weak_type=weak), place, committed=False, _skip_checks=True
        )
        for shape, kind, weak in answers
    ]

    def call(*arrays: Any) -> Sequence[Any]:
        return executable.execute_sharded([_on(device, a) for a in arrays]).consume_with_handlers(handlers)

    return call  # pyright: ignore[reportReturnType]


def _on(device: Any, array: Any) -> Any:
    return array if isinstance(array, jax.Array) and array.devices() == {device} else jax.device_put(array)
