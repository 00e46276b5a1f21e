"""Compiled programs on disk, in two files: what answers look like and which program gives them, and the program.

The first is found by source, settings and arguments, without tracing anything. The second is found by the traced
program itself, so that source that changed elsewhere costs tracing but no compilation.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax

from pftwin.kept import folder
from pftwin.kept.environment import environment
from pftwin.kept.executable import loaded, written
from pftwin.kept.identity import CannotKeepError, digest
from pftwin.kept.plain import packed, unpacked

_ANSWERS, _PROGRAMS = "answers", "programs"
Call = Callable[..., list[Any]]


def recalled(name: str) -> tuple[Call, Any] | None:
    """The program of that name and its answer's structure; None where it was not kept, or is damaged."""
    body = folder.read(_ANSWERS, name)
    if body is None:
        return None
    try:
        program, example = unpacked(body)
        structure = jax.tree.structure(example)
    except Exception:  # whatever is wrong with it, it can be made anew
        return None
    call = _loaded(program)
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
    trace = jax.jit(flat, keep_unused=True).trace(*arrays)  # what is kept takes all arguments
    lowered = trace.lower()
    text = lowered.as_text()
    program = digest((environment(), text.replace(flat.__name__, plain)))
    answer = structure()

    def finish() -> tuple[Call, bool]:
        call = None if anew else _loaded(program)
        found = call is not None
        if call is None:
            with _not_in_the_cache_of_jax():
                call = lowered.compile()
            try:
                body = written(call, trace.out_info, text)
            except CannotKeepError:
                return call, False
            folder.write(_PROGRAMS, program, body)
        # The structure as an example: its static parts come back as the very objects that they were.
        example = jax.tree.unflatten(answer, range(answer.num_leaves))
        with contextlib.suppress(CannotKeepError):
            folder.write(_ANSWERS, name, packed((program, example)))
        return call, found

    return finish


def _loaded(program: str) -> Call | None:
    body = folder.read(_PROGRAMS, program)
    if body is None:
        return None
    try:
        return loaded(body)
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
