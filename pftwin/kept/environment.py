"""Everything outside the code that decides a compiled program: versions, settings, compiler flags, the machine."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Any

import jax
from jax.extend.backend import get_backend

from pftwin.kept.reach import versions

# Settings of JAX that say where and what to log or keep, not what to compute. What is kept is for one device, whatever
# their number: a program that is laid over several is found by them, and they have no text.
_INDIFFERENT = (
    "jax_compilation_cache",
    "jax_persistent_cache",
    "jax_log",
    "jax_raise_persistent_cache",
    "jax_num_cpu_devices",
)
_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_enable_checks", "jax_check_tracer_leaks")
_LOCAL = (
    "jax_enable_x64",
    "jax_default_device",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)


def debugging() -> bool:
    """Whether JAX is asked to look into computations, which a finished program does not allow."""
    return any(getattr(jax.config, name, False) for name in _DEBUGGING)


def settings() -> tuple[Any, ...]:
    """The settings that a block of code may have to itself (`with jax.enable_x64(): ...`)."""
    return tuple(getattr(jax.config, name, None) for name in _LOCAL)


def can_keep() -> bool:
    """Whether programs are kept for this backend: the CPU's. Others are served by JAX's own cache."""
    return jax.default_backend() == "cpu"


def environment() -> str:
    """One text of it all."""
    backend = get_backend()
    chosen = {k: str(v) for k, v in sorted(jax.config.values.items()) if not k.startswith(_INDIFFERENT)}
    variables = {
        k: v for k, v in sorted(os.environ.items()) if k.startswith(("XLA_", "JAX_")) and not _cache_variable(k)
    }
    return "\n".join(
        (
            f"python {sys.version}",
            versions(),
            _machine(),
            f"{backend.platform} {backend.platform_version} {jax.local_devices()[0].device_kind}",
            repr(variables),
            _compiler_options(),
            repr(chosen),
            repr(settings()),
        )
    )


def _cache_variable(name: str) -> bool:
    return name.lower().startswith(_INDIFFERENT)


@cache
def _machine() -> str:
    """The processor and what it can do: a program may use all of it. Without such a list, the machine's own name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        able = [
            x for x in lines if x.split(":")[0].strip() in ("flags", "Features", "model name", "cpu family", "model")
        ]
    except OSError:
        able = []
    if not able:
        able = [platform.node(), platform.processor()]
    return " ".join((platform.system(), platform.machine(), *able))


def _compiler_options() -> str:
    """XLA's options as it has read them, which may not be what the environment says now."""
    try:
        from jaxlib.xla_client import CompileOptions

        return hashlib.sha256(CompileOptions().SerializeAsString()).hexdigest()
    except (ImportError, AttributeError):
        return "as in the environment"
