"""Process-wide settings for speed and precision.

The first use of a public name that computes (`pftwin.rig`, `pftwin.simulate`, ...) sets double precision and the fast
CPU compilation, or warns if JAX has already started without them. Call `pftwin.configure()` before it for other
settings. Importing pftwin alone changes nothing.

The user's settings take precedence: JAX_ENABLE_X64 in the environment, and values of these switches in XLA_FLAGS.
"""

from __future__ import annotations

import datetime
import gc
import os
import platform
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

from pftwin.base.errors import InputError, PftwinError, PftwinWarning

# Three switches of XLA's CPU compiler. A time step is a thousand scalar operations with two dozen results. By default
# XLA compiles one kernel per result, each repeating most of the arithmetic, and runs a loop's kernels one by one
# through its scheduler. The first switch lets one kernel have many results (batches run 3 times faster). The second
# compiles a loop of any size into one function (a single run is 12 times faster, a batch of 64 twice). Both halve the
# compile time. Such a loop runs on one core, and must store its outputs as rows (`dynamics.packing`). The third uses
# the full width of AVX-512 registers if available (batches run 15 to 18 % faster). Results change only by rounding.
FAST_CPU = ("xla_cpu_use_multi_output_fusion", "xla_cpu_small_while_loop_byte_threshold=100000000")
VECTOR_WIDTH = "--xla_cpu_prefer_vector_width=512"
_OPTION = "--xla_backend_extra_options="


def fast_cpu_flags(existing: str = "") -> str:
    """XLA_FLAGS with the fast CPU switches added to `existing`, whose values take precedence."""
    words = existing.split()
    others = [w for w in words if not w.startswith(_OPTION)]
    if not any(w.split("=")[0] == VECTOR_WIDTH.split("=")[0] for w in others):
        others.append(VECTOR_WIDTH)
    options = _options(existing)
    chosen = {o.split("=")[0] for o in options}
    options += [o for o in FAST_CPU if o.split("=")[0] not in chosen]
    return " ".join([*others, _OPTION + ",".join(options)])


def _options(flags: str) -> list[str]:
    """XLA's extra options in XLA_FLAGS."""
    given = [w.removeprefix(_OPTION) for w in flags.split() if w.startswith(_OPTION)]
    return [o for w in given for o in w.split(",") if o]


TESTED = ((0, 10), (0, 11))  # jaxlib versions known to have the switches: from, to below; as in pyproject.toml
_SLOW = "a run takes 26 times longer (112 ms in place of 4.3) and compiling three times longer"
_FIRST = "call pftwin.configure() before any other use of JAX"


_ON_GPU = (
    "JAX computes on a {platform} here, where one motion takes fifty times longer than on a CPU (0.78 s on an H200, "
    "0.016 s) and a fit ten times; batches gain by it. Try: JAX_PLATFORMS=cpu,cuda in the environment, which makes the "
    'CPU the default, and devices=jax.devices("cuda") for batches'
)


class _Process:
    """State of the settings in this process."""

    settled = False  # by `configure` or by `use_defaults`
    flags_before: str | None = None  # XLA_FLAGS before `use_defaults` changed them
    float64_by_default = False  # set by `use_defaults`
    warned_of_accelerator = False


def use_defaults() -> None:
    """Applies the defaults of `configure()` once; does nothing if `configure` was called.

    Warns:
        PftwinWarning: JAX has already started without them, or the user's settings make it slow or imprecise.
    """
    if _Process.settled:
        return
    _Process.settled = True
    given = os.environ.get("XLA_FLAGS", "")
    flags, found = fast_cpu_flags(given), []
    import jax

    if _jax_has_started():
        if set(flags.split()) != set(given.split()):
            found.append(f"JAX started without the fast CPU compilation: {_SLOW}; try: {_FIRST}")
        if not _double():
            found.append(f"JAX started in single precision, and pftwin computes in float32; try: {_FIRST}")
    else:
        if untested := _untested():
            found.append(f"{untested}: {_SLOW}")
        else:
            _Process.flags_before, os.environ["XLA_FLAGS"] = given, flags
        if "JAX_ENABLE_X64" not in os.environ:
            jax.config.update("jax_enable_x64", True)
            _Process.float64_by_default = True
        elif not _double():
            found.append("JAX_ENABLE_X64 is off, and pftwin computes in float32; try: unset it")
    if chosen := [o.split("=")[0] for o in FAST_CPU if o not in _options(flags)]:
        found.append(f"XLA_FLAGS has its own value of {', '.join(chosen)}, which stays; without it pftwin is faster")
    for text in found:
        warnings.warn(text, PftwinWarning, stacklevel=3)


def warn_of_accelerator(platform: str) -> None:
    """Warns once per process that sequential computations are slow on an accelerator.

    Warns:
        PftwinWarning: `platform` is not "cpu".
    """
    if platform != "cpu" and not _Process.warned_of_accelerator:
        _Process.warned_of_accelerator = True
        warnings.warn(_ON_GPU.format(platform=platform.upper()), PftwinWarning, stacklevel=3)


def _double() -> bool:
    import jax

    return jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def _untested() -> str | None:
    """Why the switches are not set on this jaxlib, if so: XLA aborts the process on an unknown switch."""
    installed = version("jaxlib")
    if TESTED[0] <= tuple(int(n) for n in installed.split(".")[:2]) < TESTED[1]:
        return None
    return f"jaxlib {installed} is not one of those tested, so the fast CPU compilation is left off"


def configure(
    *,
    float64: bool = True,
    fast_cpu: bool = True,
    cache_dir: str | os.PathLike[str] | bool | None = None,
    cpu_devices: int | str | None = None,
) -> None:
    """Configures the process: double precision, fast CPU compilation, cache folder and number of CPU devices.

    Call it before the first JAX computation. Programs that do not call it use the defaults, without a cache folder.

    Args:
        float64: compute in double precision; False: use JAX's setting, which is single precision by default.
        fast_cpu: enable the fast CPU compilation.
        cache_dir: folder that caches compiled programs and data derived from files (fitted patches, filtered
            recordings) for later processes. As cached programs are executed, a folder that another user owns or can
            write to is ignored with a warning, and so is a path that cannot be a folder. True: the command line's
            folder, $PFTWIN_CACHE or one in the user's cache folder. By default nothing is cached.
        cpu_devices: number of JAX devices into which the CPU is divided, over which batches are distributed. "all":
            one per core that this process may use. By default JAX's setting applies, which is one.

    Raises:
        PftwinError: JAX has already started, so that `fast_cpu` or `cpu_devices` would have no effect.
        InputError: `cpu_devices` is neither "all" nor a positive integer.
    """
    import jax

    _set_flags(fast_cpu)
    if cpu_devices is not None:
        _count_cpu_devices(cpu_devices)
    gc.freeze()  # excludes the hundred thousand permanent objects of these imports from garbage collection
    if float64:
        jax.config.update("jax_enable_x64", True)
    elif _Process.float64_by_default:
        jax.config.update("jax_enable_x64", False)
    _Process.settled = True
    if cache_dir is not None and cache_dir is not False:
        from pftwin.base import cache_folder

        folder = Path(default_cache_dir() if cache_dir is True else cache_dir)
        if cache_folder.use_cache_folder(folder):
            compiled = cache_folder.compiled_folder(folder.absolute())
            jax.config.update("jax_compilation_cache_dir", str(compiled))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
            jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _count_cpu_devices(wanted: int | str) -> None:
    """Sets JAX's number of CPU devices, which JAX reads only when it starts."""
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


def _set_flags(fast_cpu: bool) -> None:
    given = os.environ.get("XLA_FLAGS", "")
    wanted = fast_cpu_flags(given) if fast_cpu else given if _Process.flags_before is None else _Process.flags_before
    if set(wanted.split()) == set(given.split()):  # in any order
        return
    if _jax_has_started():
        raise PftwinError(
            f"JAX has already computed something, so the fast CPU compilation cannot be switched "
            f"{'on' if fast_cpu else 'off'} any more; try: {_FIRST}, or pass fast_cpu={not fast_cpu}"
        )
    if fast_cpu and (untested := _untested()):
        warnings.warn(f"{untested}: {_SLOW}", PftwinWarning, stacklevel=3)
        return
    os.environ["XLA_FLAGS"] = wanted


def _jax_has_started() -> bool:
    """Whether JAX has initialised its devices: it then refuses to change their number. The check does not start it."""
    if "jax" not in sys.modules:
        return False
    import jax

    own = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", 2 if own == 1 else 1)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", own)
    return False


def default_cache_dir() -> str:
    """Default cache folder of the command line: $PFTWIN_CACHE, or one in the user's cache folder."""
    base = os.environ.get("PFTWIN_CACHE")
    if base:
        return base
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return os.path.join(home, "pftwin", "compiled")


def describe() -> dict[str, str | int]:
    """Environment of a benchmark: processor, cores, versions, float type and date."""
    import jax
    import jax.numpy as jnp

    import pftwin

    return {
        "cpu": _cpu(),
        "cores": cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "load": f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown",
        "python": platform.python_version(),
        "jax": jax.__version__,
        "backend": jax.default_backend(),
        "dtype": str(jnp.zeros(()).dtype),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "pftwin": pftwin.__version__,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes"),
    }


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
