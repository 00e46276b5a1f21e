"""A function of shared values and of per-member rows, with the rows distributed over devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jax.sharding import Mesh, PartitionSpec

AXIS = "batch"
SHARED, SPLIT = PartitionSpec(), PartitionSpec(AXIS)


def shard_over(mesh: Mesh, function: Callable[..., Any], shared: Any, each: tuple[Any, ...], out: Any = SPLIT) -> Any:
    """function(shared, *each) on every device of a mesh with its own rows. For use within a compiled program.

    Args:
        mesh: one-dimensional, over `AXIS`.
        function: pure; it is given its device's rows.
        shared: a tree; its leaves that are not arrays stay static.
        each: trees of arrays whose leading axis is distributed over the devices.
        out: how the result's axes are distributed.
    """
    arrays, fixed = eqx.partition(shared, eqx.is_array)
    # Loop carries differ between devices; the check that would have to prove this is off.
    return jax.shard_map(
        lambda own, *rows: function(eqx.combine(own, fixed), *rows),
        mesh=mesh,
        in_specs=(SHARED, *[SPLIT] * len(each)),
        out_specs=out,
        check_vma=False,
    )(arrays, *each)
