"""Functions compiled once for each kind of argument, with compilation told apart from running, and kept on disk."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax.core import ShapedArray, Tracer

from pftwin.kept import folder, store
from pftwin.kept.environment import can_keep, debugging, environment, settings
from pftwin.kept.identity import CannotKeepError, digest, node_types, structure_text, value_text
from pftwin.kept.reach import reach, source


class Timed(NamedTuple):
    """An answer and what it took."""

    answer: Any
    run: float  # [s]
    preparation: float  # compiling, or loading what was kept; 0 where neither was needed [s]


class _Ready(NamedTuple):
    call: Callable[..., list[Any]]  # from arrays to arrays
    structure: Any  # the answer's
    loaded: bool  # from disk, rather than compiled here


class _Kind(NamedTuple):
    """What decides the program for some arguments, within a process."""

    structure: Any
    fixed: tuple[Any, ...]  # of every leaf None, or for one that is no array its type and itself
    arrays: tuple[Hashable, ...]  # shape and type, weak or strong
    settings: tuple[Any, ...]


class Program:
    """A function of pytrees, jitted: arrays are its variables, all other leaves and the structure decide the program.

    Where a folder is chosen (`pftwin.configure(cache_dir=...)`), compiled programs are kept in it, and another process
    neither traces nor compiles. What a program is found by holds all that decides it: pftwin's source, the constants
    and functions it looks up, versions, settings, compiler flags and processor, and the arguments' kind. Where that
    cannot be told (effects from outside pftwin, source that changed meanwhile, a program over several devices),
    nothing is kept.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function, self._jitted = function, eqx.filter_jit(function)
        self._ready: dict[_Kind, _Ready] = {}
        functools.update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        """The answer."""
        return self.timed(*args).answer

    def timed(self, *args: Any) -> Timed:
        """The answer, which is there when this returns, and what it took."""
        kind, arrays = _kind_of(args)
        began = time.perf_counter()
        if debugging() or any(isinstance(a, Tracer) for a in arrays):
            answer = jax.block_until_ready(self._jitted(*args))
            return Timed(answer, time.perf_counter() - began, 0.0)
        ready = self._ready.get(kind)
        prepared = began
        if ready is None:
            ready = self._ready[kind] = self._prepared(kind, arrays)
            prepared = time.perf_counter()
        try:
            out = jax.block_until_ready(ready.call(*arrays))
        except Exception:
            if not ready.loaded:
                raise
            ready = self._ready[kind] = self._prepared(kind, arrays, anew=True)  # what was kept does not run
            prepared = time.perf_counter()
            out = jax.block_until_ready(ready.call(*arrays))
        return Timed(jax.tree.unflatten(ready.structure, out), time.perf_counter() - prepared, prepared - began)

    def at_hand(self, *args: Any) -> bool:
        """Whether arguments of this kind need no compilation: it was done here, or by a former process."""
        kind, _ = _kind_of(args)
        if debugging() or kind in self._ready:
            return True
        name = self._name(kind)
        loaded = None if name is None else store.recalled(name)
        if loaded is not None:
            self._ready[kind] = _Ready(*loaded, True)
        return loaded is not None

    def prepare(self, *args: Any) -> None:
        """Compiles for arguments of this kind, or loads what was kept. Arrays may be `jax.ShapeDtypeStruct`s."""
        self.begin(*args)()

    def begin(self, *args: Any) -> Callable[[], None]:
        """The first part of `prepare`, tracing, which two threads cannot do at once; what it returns does the rest."""
        kind, arrays = _kind_of(args)
        if kind in self._ready:
            return lambda: None
        rest = self._traced(kind, arrays)

        def finish() -> None:
            self._ready[kind] = rest()

        return finish

    def _prepared(self, kind: _Kind, arrays: list[Any], anew: bool = False) -> _Ready:
        """Loaded if it was kept, else compiled, and kept."""
        return self._traced(kind, arrays, anew)()

    def _traced(self, kind: _Kind, arrays: list[Any], anew: bool = False) -> Callable[[], _Ready]:
        """The second part of `_prepared`, the first being done."""
        name = self._name(kind)
        if name is not None and not anew and (loaded := store.recalled(name)) is not None:
            return lambda: _Ready(*loaded, True)
        flat, structure = self._flat(kind)
        if name is None:
            lowered = jax.jit(flat).lower(*arrays)
            return lambda: _Ready(lowered.compile(), structure(), False)
        finish = store.traced(name, flat, structure, arrays, anew)

        def ready() -> _Ready:
            call, loaded_here = finish()
            return _Ready(call, structure(), loaded_here)

        return ready

    def _flat(self, kind: _Kind) -> tuple[Callable[..., list[Any]], Callable[[], Any]]:
        """The function from arrays to arrays, and the answer's structure, known once that has been traced."""
        outer = []

        def flat(*arrays: Any) -> list[Any]:
            rest = iter(arrays)
            args = jax.tree.unflatten(kind.structure, [next(rest) if f is None else f[1] for f in kind.fixed])
            out, structure = jax.tree.flatten(self._function(*args))
            outer.append(structure)
            return out

        flat.__name__ = self._function.__name__
        return flat, lambda: outer[0]

    def _name(self, kind: _Kind) -> str | None:
        """What the program is kept as; None where nothing is kept."""
        if folder.chosen() is None or not can_keep():
            return None
        try:
            own = [t for t in node_types(kind.structure) if t.__module__.startswith("pftwin")]
            return digest(
                (
                    source(),
                    reach(self._function, *sorted(own, key=lambda t: (t.__module__, t.__qualname__))),
                    environment(),
                    structure_text(kind.structure),
                    value_text([None if f is None else (f[1],) for f in kind.fixed]),
                    repr(kind.arrays),
                )
            )
        except CannotKeepError:
            return None


def _varies(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _kind_of(args: tuple[Any, ...]) -> tuple[_Kind, list[Any]]:
    """The arguments' kind, and those that are arrays."""
    leaves, structure = jax.tree.flatten(args)
    varies = [_varies(a) for a in leaves]
    arrays = [a for a, varied in zip(leaves, varies, strict=True) if varied]
    fixed = tuple(None if varied else (type(a), a) for a, varied in zip(leaves, varies, strict=True))
    return _Kind(structure, fixed, tuple(_array_kind(a) for a in arrays), settings()), arrays


def _array_kind(array: Any) -> Hashable:
    if isinstance(array, jax.ShapeDtypeStruct):
        return ShapedArray(array.shape, array.dtype, weak_type=array.weak_type)
    aval = getattr(array, "aval", None)
    return (array.shape, array.dtype) if aval is None else aval
