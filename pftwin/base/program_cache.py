"""Cache of compiled programs and of values derived from files for later processes (`configure(cache_dir=...)`).

A program is stored in the format of `jax.export`, so that another process need not trace it; its machine code is in
JAX's compilation cache. The key consists of the source files of pftwin, and of the packages of the function and of its
arguments' types, the versions of the libraries, and the arguments. The source files do not reflect monkey-patching of
these modules at run time: do not use a cache folder with it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import sys
import time
import warnings
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Executor
from importlib.metadata import version
from pathlib import Path
from threading import Lock, RLock
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.export
import numpy as np
from jax.core import Tracer

import pftwin
from pftwin.base import cache_folder
from pftwin.base.leaves import Fixed, split_arguments
from pftwin.base.serialization import PACKAGES, NotPlainError, fingerprint, from_bytes, to_bytes
from pftwin.base.text_files import MESH_BYTES

T = TypeVar("T")
_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optax", "numpy", "scipy", "trimesh")
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_device",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)
_DEBUGGING = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs", "jax_enable_checks", "jax_check_tracer_leaks")


class Timed(NamedTuple):
    """Result of a program and the time it took."""

    answer: Any
    run: float  # [s]
    preparation: float  # time to compile or to load from the cache; 0 if already compiled [s]


class _Kind(NamedTuple):
    """Key that determines the compiled program for some arguments."""

    fixed: Fixed
    arrays: tuple[Hashable, ...]  # shape, type, and whether the type is weak
    settings: tuple[Any, ...]


class Program:
    """A function of pytrees that is compiled once per kind of arguments; compilation and run are timed separately.

    The kind comprises the structure, the shapes and types of arrays, all other leaves, and JAX's `settings`.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function, self._jitted = function, eqx.filter_jit(function)
        self._ready: dict[_Kind, tuple[Callable[..., Any], Any]] = {}  # program and structure of its result
        self._begun: dict[_Kind, Callable[[], None]] = {}  # functions that compile the traced programs
        self._lock = RLock()  # guards both
        functools.update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        """Runs the program, and compiles it first if needed."""
        return self.timed(*args).answer

    def timed(self, *args: Any) -> Timed:
        """Runs the program, waits for the result, and returns it with the times."""
        kind, arrays = _kind_of(args)
        began = prepared = time.perf_counter()
        if _debugging() or any(isinstance(a, Tracer) for a in arrays):
            return Timed(jax.block_until_ready(self._jitted(*args)), time.perf_counter() - began, 0.0)
        if kind not in self._ready:
            self.prepare(*args)
            prepared = time.perf_counter()
        call, structure = self._ready[kind]
        out = jax.block_until_ready(call(*arrays))
        return Timed(jax.tree.unflatten(structure, out), time.perf_counter() - prepared, prepared - began)

    def at_hand(self, *args: Any) -> bool:
        """Whether this process has compiled the program for arguments of this kind."""
        return _kind_of(args)[0] in self._ready

    def prepare(self, *args: Any) -> None:
        """Compiles for arguments of this kind, or loads from the cache. Arrays may be `jax.ShapeDtypeStruct`s."""
        self.begin(*args)()

    def begin(self, *args: Any) -> Callable[[], None]:
        """Traces the program, in one thread at a time. The returned function compiles it, or waits for another thread
        that does; it raises if compilation fails, and the next call tries again."""
        kind, arrays = _kind_of(args)
        with self._lock:
            if kind in self._ready:
                return lambda: None
            if kind not in self._begun:
                self._begun[kind] = self._traced(kind, arrays, args)
            return self._begun[kind]

    def _traced(self, kind: _Kind, arrays: list[Any], args: Any) -> Callable[[], None]:
        """Traces the program; returns a function that compiles it once."""
        shapes = jax.tree.map(lambda a: _shape(a) if _is_array(a) else a, args)
        key = _key(self._function, (shapes, repr(kind.settings), jax.default_backend()))
        lowered, structure = self._lowered(kind, arrays, key)
        one_at_a_time = Lock()

        def finish() -> None:
            with one_at_a_time:
                if kind in self._ready:
                    return
                compiled = lowered.compile()
                with self._lock:
                    self._ready[kind] = compiled, structure
                    self._begun.pop(kind, None)

        return finish

    def _lowered(self, kind: _Kind, arrays: list[Any], key: str | None) -> tuple[Any, Any]:
        """The lowered program, from the cache if stored there, and the structure of its result."""
        structures = []

        def flat(*arrays: Any) -> list[Any]:
            out, structure = jax.tree.flatten(self._function(*kind.fixed.with_arrays(arrays)))
            structures.append(structure)
            return out

        flat.__name__ = self._function.__name__
        if key is not None:
            with contextlib.suppress(Exception):  # damaged or missing: traced again
                stored, example = from_bytes(cache_folder.read("programs", key) or b"")
                program = jax.jit(jax.export.deserialize(bytearray(stored)).call)
                return program.lower(*arrays), jax.tree.structure(example)
            with contextlib.suppress(ValueError, NotImplementedError, NotPlainError):  # not supported by export
                exported = jax.export.export(jax.jit(flat))(*arrays)
                example = jax.tree.unflatten(structures[0], range(structures[0].num_leaves))
                stored = to_bytes((np.frombuffer(exported.serialize(), np.uint8), example))
                cache_folder.write("programs", key, stored)
                return jax.jit(exported.call).lower(*arrays), structures[0]
        return jax.jit(flat).lower(*arrays), structures[-1]


def cached(function: Callable[..., T], *args: Any, files: Sequence[Path]) -> T:
    """function(*args), or its stored value for the same arguments, content of `files` and source code.

    The value must depend on nothing else. It is stored only if `serialization.to_bytes` supports it, and if the
    function did not warn, so that warnings occur again.
    """
    key = _key(function, args, files)
    if key is None:
        return function(*args)
    body = cache_folder.read("values", key)
    if body is not None:
        with contextlib.suppress(Exception):  # damaged: it is computed again
            return from_bytes(body)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        value = function(*args)
    for w in warned:
        warnings.warn_explicit(w.message, w.category, w.filename, w.lineno)
    if not warned and _key(function, args, files) == key:  # the files are still those that were read
        with contextlib.suppress(NotPlainError):
            cache_folder.write("values", key, to_bytes(value))
    return value


def settings() -> tuple[Any, ...]:
    """JAX settings that may change locally, e.g. in `with jax.enable_x64(True): ...`."""
    return tuple(getattr(jax.config, name) for name in _SETTINGS)


def shares_settings(threads: Executor) -> bool:
    """Whether programs run in these threads as in this one: a local change of JAX's settings applies to one thread, and
    for debugging programs are traced anew, which only one thread may do at a time."""

    return threads.submit(settings).result() == settings() and not _debugging()


def _debugging() -> bool:
    return any(getattr(jax.config, name) for name in _DEBUGGING)


@functools.cache
def versions() -> str:
    """Versions of the libraries that affect numerical results."""
    return ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)


def _key(function: Callable[..., Any], args: Any, files: Sequence[Path] = ()) -> str | None:
    """Key of a result in the cache; None without a cache folder, or if its dependencies cannot be determined."""
    name = f"{function.__module__}.{function.__qualname__}"
    package = name.partition(".")[0]
    if cache_folder.chosen() is None or package not in PACKAGES or "<locals>" in name:
        return None
    try:
        if any(file.is_file() and file.stat().st_size > MESH_BYTES for file in files):
            return None
        contents = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
        body = to_bytes(args)
        types = (p for p in PACKAGES if f'"{p}.'.encode() in body)  # packages of types among the arguments
        sources = [_source(p) for p in sorted({"pftwin", package, *types})]
        return fingerprint([sources, versions(), name, contents, hashlib.sha256(body).hexdigest()])
    except (NotPlainError, OSError):
        return None


def _source(package: str) -> str:
    """Hash of a package's source files; raises `NotPlainError` if one changed after pftwin was imported."""
    folder = Path(sys.modules[package].__path__[0])
    files = sorted(folder.rglob("*.py"))
    if max(file.stat().st_mtime for file in files) > pftwin.imported_at:
        raise NotPlainError("the source changed after this process began")
    return _hash_of(folder, tuple(files))


@functools.cache
def _hash_of(folder: Path, files: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for file in files:
        content = file.read_bytes()
        total.update(f"{file.relative_to(folder)} {len(content)} ".encode() + content)
    return total.hexdigest()


def _is_array(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _shape(array: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(array.shape, array.dtype, weak_type=getattr(array, "weak_type", False))


def _kind_of(args: tuple[Any, ...]) -> tuple[_Kind, list[Any]]:
    """Kind of the arguments, and the arrays among them."""
    fixed, arrays = split_arguments(args, _is_array)
    # Runs before every call: plain tuples are hashed and compared ten times faster than `ShapeDtypeStruct`s.
    kinds = tuple((a.shape, a.dtype, getattr(a, "weak_type", False)) for a in arrays)
    return _Kind(fixed, kinds, settings()), arrays
