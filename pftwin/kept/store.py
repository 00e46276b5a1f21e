"""Compiled programs on disk, in two files: what answers look like and which program gives them, and the program.

The first is found by source, settings and arguments, without tracing anything. The second is found by the traced
program itself, so that source that changed elsewhere costs tracing but no compilation.
"""

from __future__ import annotations

import pickle
import secrets
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from pftwin.kept import folder
from pftwin.kept.environment import environment
from pftwin.kept.identity import digest

_ANSWERS, _PROGRAMS = "answers", "programs"
Call = Callable[..., list[Any]]


def recalled(name: str, arguments: int) -> tuple[Call, Any] | None:
    """The program of that name and its answer's structure; None where it was not kept, or is damaged."""
    body = folder.read(_ANSWERS, name)
    if body is None:
        return None
    try:
        program, example = pickle.loads(body)
        structure = jax.tree.structure(example)
    except Exception:  # whatever is wrong with it, it can be made anew
        return None
    call = _loaded(program, arguments, structure.num_leaves)
    return None if call is None else (call, structure)


def traced(
    name: str, flat: Callable[..., Any], structure: Callable[[], Any], arrays: list[Any], anew: bool
) -> Callable[[], tuple[Call, bool]]:
    """Traces a function; what it returns gives the compiled function, keeps it, and says if a former process had.

    Args:
        name: what its answer is kept as.
        flat: from arrays to a list of arrays.
        structure: the answer's, once `flat` has been traced.
        arrays: arguments of the kind to compile for.
        anew: compile it even if it was kept.
    """
    # A name that no other process uses keeps JAX's own cache out of this: an executable that came out of that cache
    # cannot be written down again (it lacks functions when it is next loaded).
    plain = flat.__name__
    flat.__name__ = f"{plain}_{secrets.token_hex(4)}"
    lowered = jax.jit(flat).lower(*arrays)
    program = digest((environment(), lowered.as_text().replace(flat.__name__, plain)))
    answer = structure()

    def finish() -> tuple[Call, bool]:
        call = None if anew else _loaded(program, len(arrays), answer.num_leaves)
        found = call is not None
        if call is None:
            with _not_in_the_cache_of_jax():
                call = lowered.compile()
            try:
                body = zlib.compress(serialize(call)[0], 1)
            except Exception:  # a version of JAX that cannot write programs down
                return call, False
            folder.write(_PROGRAMS, program, body)
        # The structure as an example: its static parts come back as the very objects that they were.
        example = jax.tree.unflatten(answer, range(answer.num_leaves))
        folder.write(_ANSWERS, name, pickle.dumps((program, example)))
        return call, found

    return finish


def _loaded(program: str, arguments: int, answers: int) -> Call | None:
    body = folder.read(_PROGRAMS, program)
    if body is None:
        return None
    ins, outs = jax.tree.structure(((0,) * arguments, {})), jax.tree.structure([0] * answers)
    try:
        return deserialize_and_load(zlib.decompress(body), ins, outs)
    except Exception:  # whatever is wrong with it, it can be compiled anew
        return None


@contextmanager
def _not_in_the_cache_of_jax() -> Iterator[None]:
    """Nothing compiled meanwhile is written to JAX's cache, where it would only be a second copy."""
    setting = "jax_persistent_cache_min_compile_time_secs"
    with _lock:
        if not _compiling:
            _compiling.append(jax.config.values[setting])
            jax.config.update(setting, 1e9)
        _compiling.append(None)
    try:
        yield
    finally:
        with _lock:
            _compiling.pop()
            if len(_compiling) == 1:  # the last of several threads
                jax.config.update(setting, _compiling.pop())


_lock = threading.Lock()
_compiling: list[Any] = []  # the setting as it was, and one more entry for every thread that compiles
