"""A function of what all members share and of each one's rows, with the rows laid over devices."""

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
        shared: a tree; what is no array of it stays as it is.
        each: trees of arrays whose leading axis is laid over the devices.
        out: how the answer's axes are laid.
    """
    arrays, fixed = eqx.partition(shared, eqx.is_array)
    # What the loops carry differs from device to device, which nobody has to prove here.
    return jax.shard_map(
        lambda own, *rows: function(eqx.combine(own, fixed), *rows),
        mesh=mesh,
        in_specs=(SHARED, *[SPLIT] * len(each)),
        out_specs=out,
        check_vma=False,
    )(arrays, *each)
