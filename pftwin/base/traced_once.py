"""Functions used in several programs, or several places of one program, that JAX traces only once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import equinox as eqx
import jax

F = TypeVar("F", bound=Callable[..., Any])


class Fixed(NamedTuple):
    """The parts of a function's arguments that are not arrays."""

    structure: Any
    leaves: tuple[Hashable, ...]  # of every leaf None, or for one that is no array its type and itself

    def with_arrays(self, arrays: Iterable[Any]) -> Any:
        """The arguments."""
        rest = iter(arrays)
        leaves: list[Any] = [next(rest) if leaf is None else cast(tuple[Any, Any], leaf)[1] for leaf in self.leaves]
        return jax.tree.unflatten(self.structure, leaves)


def split_arguments(args: Any, is_array: Callable[[Any], bool] = eqx.is_array) -> tuple[Fixed, list[Any]]:
    """Splits arguments into what determines a program and the arrays that it takes."""
    leaves, structure = jax.tree.flatten(args)
    arrays: list[Any] = []
    fixed: list[Hashable] = []
    for leaf in leaves:
        here = is_array(leaf)
        fixed.append(None if here else (type(leaf), leaf))
        if here:
            arrays.append(leaf)
    return Fixed(structure, tuple(fixed)), arrays


def traced_once(function: F) -> F:
    """JAX traces the function once for each kind of arguments and reuses the trace wherever else it is called.

    The programs are the same. Where contacts are traced this way, a process's second program is traced in half the
    time.
    """

    @functools.partial(jax.jit, static_argnums=0, inline=True)
    def of_arrays(fixed: Fixed, arrays: Sequence[Any]) -> Any:
        return function(*fixed.with_arrays(arrays))

    @functools.wraps(function)
    def traced(*args: Any) -> Any:
        return of_arrays(*split_arguments(args))

    return cast(F, traced)
