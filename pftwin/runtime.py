"""Settings of the process that make the difference in speed; applied by the command line, tests and benchmarks.

Importing pftwin changes nothing. A program that wants double precision and the fast CPU compilation calls
`pftwin.configure()` first thing.
"""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

from pftwin.errors import InputError, PftwinError

# Three switches of XLA's CPU compiler. A time step is a thousand scalar operations with two dozen results. By default
# XLA compiles one kernel per result, each repeating most of the arithmetic, and runs a loop's kernels one by one
# through its scheduler. The first switch lets one kernel have many results (batches run 3 times faster), the second
# compiles a loop into one function however much it holds (a single run is 12 times faster, a batch of 64 twice); both
# halve the compile time. Such a loop runs on one core, and must store what it puts out as rows (`dynamics.packing`).
# The third uses the whole width of AVX-512 registers where there are any (batches run 15 to 18 % faster). Answers do
# not change beyond rounding.
FAST_CPU = ("xla_cpu_use_multi_output_fusion", "xla_cpu_small_while_loop_byte_threshold=100000000")
VECTOR_WIDTH = "--xla_cpu_prefer_vector_width=512"
_OPTION = "--xla_backend_extra_options="


def fast_cpu_flags(existing: str = "") -> str:
    """XLA_FLAGS with the fast CPU switches added to whatever was there; a value that was given stays."""
    words = existing.split()
    given = [w for w in words if w.startswith(_OPTION)]
    others = [w for w in words if not w.startswith(_OPTION)]
    if not any(w.split("=")[0] == VECTOR_WIDTH.split("=")[0] for w in others):
        others.append(VECTOR_WIDTH)
    options = [o for w in given for o in w.removeprefix(_OPTION).split(",") if o]
    chosen = {o.split("=")[0] for o in options}
    options += [o for o in FAST_CPU if o.split("=")[0] not in chosen]
    return " ".join([*others, _OPTION + ",".join(options)])


def configure(
    *,
    float64: bool = True,
    fast_cpu: bool = True,
    cache_dir: str | os.PathLike[str] | None = None,
    cpu_devices: int | str | None = None,
) -> None:
    """Sets up the process: double precision, fast CPU compilation, a folder in which things persist, CPU devices.

    Call it before the first JAX computation.

    Args:
        float64: compute in double precision.
        fast_cpu: switch on the fast CPU compilation.
        cache_dir: folder in which compiled programs, and what was derived from files (fitted patches, filtered
            recordings), are kept for later processes. Programs found in it are run: a folder that another user owns or
            can write to is not used, and a warning says so. By default nothing is kept.
        cpu_devices: as how many devices JAX counts the CPU: batches are laid over all of them. "all": one for each
            core that this process may use. By default JAX's own choice stays, which is one.

    Raises:
        PftwinError: JAX has already started, and `fast_cpu` or `cpu_devices` could have no effect any more.
        InputError: a number of devices that is none.
    """
    given = os.environ.get("XLA_FLAGS", "")
    flags = fast_cpu_flags(given)
    if fast_cpu and set(flags.split()) != set(given.split()):  # in whatever order
        if _jax_has_started():
            raise PftwinError(
                "JAX has already computed something, so the fast CPU compilation cannot be switched on any more; "
                "try: call pftwin.configure() before any other use of JAX, or pass fast_cpu=False"
            )
        os.environ["XLA_FLAGS"] = flags
    import jax

    if cpu_devices is not None:
        _count_cpu_devices(cpu_devices)
    gc.freeze()  # the hundred thousand objects of these imports stay: never searched for garbage, nor when all ends
    if float64:
        jax.config.update("jax_enable_x64", True)
    if cache_dir is not None:
        from pftwin.kept import folder

        if folder.use(cache_dir):
            Path(cache_dir).mkdir(mode=0o700, parents=True, exist_ok=True)  # JAX would make it by the user's mask
            jax.config.update("jax_compilation_cache_dir", str(cache_dir))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
            jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _count_cpu_devices(wanted: int | str) -> None:
    """Tells JAX, which asks once, as it starts."""
    import jax

    count = cores() if wanted == "all" else wanted
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise InputError(f"found {wanted!r}", where="cpu_devices", expected='"all", or a whole number, at least 1')
    if not _jax_has_started():
        jax.config.update("jax_num_cpu_devices", count)
        return
    there = len(jax.local_devices(backend="cpu"))
    if there != count:
        raise PftwinError(
            f"JAX has already started with {there} CPU device(s), so there cannot be {count} any more; try: call "
            f"pftwin.configure(cpu_devices={count}) before any other use of JAX"
        )


def _jax_has_started() -> bool:
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(bridge is not None and getattr(bridge, "_backends", None))


def default_cache_dir() -> str:
    """Where the command line keeps compiled programs: $PFTWIN_CACHE, else the user's cache folder."""
    base = os.environ.get("PFTWIN_CACHE")
    if base:
        return base
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return os.path.join(home, "pftwin", "compiled")
