"""Mapping of a function over a batch: `vmap` in pieces of a size that suits the processor, on one or several devices.

A step reads and writes hundreds of arrays of the length of a piece, which are consecutive in memory. A piece of about a
hundred variants fits into a core's second-level cache, and pieces run one after the other. If the length is a large
power of two, the same element of all arrays maps to the same few cache lines (4 KiB aliasing), so such pieces are
padded with a few unused variants. An accelerator has thousands of lanes and launches every operation of a step
separately: on an H200 a step of 131,000 variants takes four times as long as one of 2,000.

`Sharding` has one program per kind of scene, and pieces of one size. Every device loops over its pieces, whose number
is not part of the program. So a variant's result is the same to the last bit whatever the size of chunks and its
position in the batch. For several devices XLA partitions the program with passes that a single-device program does not
need, so results on one device and on several differ by rounding. Incomplete pieces are padded with copies of the last
variant; unused pieces are not run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array
from numpy.typing import NDArray

PIECE = 120  # largest number of variants in a piece
ACCELERATED = 131_072  # the same on an accelerator
ALIASING = 64  # sizes that are multiples of this are avoided
FILL = 8  # number of variants added to such a size: one vector register of float64
FEW = 16  # number of variants per piece in a small batch
AXIS = "batch"
SHARED, SPLIT = PartitionSpec(), PartitionSpec(AXIS)


def good_sizes(n: int, platform: str | None = None) -> tuple[int, int]:
    """Number and size of the pieces for a batch; together they contain at least n variants.

    Args:
        n: number of variants.
        platform: platform of the devices; by default JAX's.
    """
    on_cpu = (platform or jax.default_backend()) == "cpu"
    pieces = max(1, -(-n // (PIECE if on_cpu else ACCELERATED)))
    size = -(-n // pieces)
    return pieces, size + FILL if on_cpu and size % ALIASING == 0 and size > 0 else size


def batched(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.vmap(function)` over the leading axis of all arrays in all arguments, in pieces of a suitable size."""

    def run(*args: Any) -> Any:
        n = jax.tree.leaves(args)[0].shape[0]
        pieces, size = good_sizes(n)
        fill = pieces * size - n
        if fill:
            args = jax.tree.map(lambda a: jnp.concatenate([a, jnp.repeat(a[-1:], fill, axis=0)]), args)
        if pieces == 1:
            out = jax.vmap(function)(*args)
        else:
            split = jax.tree.map(lambda a: a.reshape(pieces, size, *a.shape[1:]), args)
            out = jax.lax.map(lambda some: jax.vmap(function)(*some), split)
            out = jax.tree.map(lambda a: a.reshape(pieces * size, *a.shape[2:]), out)
        return jax.tree.map(lambda a: a[:n], out) if fill else out

    return run


def piece_for(n: int, platform: str) -> int:
    """Number of variants per piece for a batch of n; it has few different values, so that programs are shared."""
    if platform != "cpu":
        return min(ACCELERATED, max(FEW, 1 << (n - 1).bit_length()))
    return FEW if n <= 2 * FEW else PIECE


@eqx.filter_jit
def _on_devices(function: Callable[..., Any], mesh: Mesh, shared: Any, counts: Array, each: Any) -> Any:
    """function(shared, *row) for rows in `each`, (devices * pieces, members, ...); devices run `counts` pieces each."""

    def of_one_device(shared: Any, counts: Array, rows: Any) -> Any:
        arrays, fixed = eqx.partition(shared, eqx.is_array)

        @partial(jax.jit, inline=True)  # jit: traced once for both the shapes and the result
        def piece(arrays: Any, some: Any) -> Any:
            return jax.vmap(lambda row: function(eqx.combine(arrays, fixed), *row))(some)

        def rows_of(i: Array) -> Any:
            return jax.tree.map(lambda a: jax.lax.dynamic_index_in_dim(a, i, keepdims=False), rows)

        pieces = jax.tree.leaves(rows)[0].shape[0]
        shapes = jax.eval_shape(lambda i: piece(arrays, rows_of(i)), jnp.zeros((), int))
        empty = jax.tree.map(lambda a: jnp.zeros((pieces, *a.shape), a.dtype), shapes)

        def put(i: Array, out: Any) -> Any:
            found = piece(arrays, rows_of(i))
            return jax.tree.map(lambda o, a: jax.lax.dynamic_update_index_in_dim(o, a, i, 0), out, found)

        return jax.lax.fori_loop(0, counts[0], put, empty)

    return shard_over(mesh, of_one_device, shared, (counts, each))


class Chunk(NamedTuple):
    """Variants that are computed together, and their assignment to devices."""

    rows: NDArray[np.int64]  # (devices * pieces, piece) index of the variant at each position
    counts: NDArray[np.int64]  # (devices,) number of pieces that each device runs
    used: NDArray[np.int64]  # indices of the used pieces, in the order of their variants
    members: int  # number of variants


class Sharding:
    """Devices, and the distribution of variants over them.

    Args:
        devices: devices of one platform.
        piece: number of variants that are vectorised together.
        chunk: maximum number of variants per transfer of results to the host; at least a piece per device is used.
    """

    def __init__(self, devices: tuple[Any, ...], piece: int, chunk: int) -> None:
        self._mesh = Mesh(np.array(devices), (AXIS,))
        self.devices, self.piece = len(devices), piece
        self._pieces = max(1, chunk // (piece * len(devices)))

    @property
    def most(self) -> int:
        """Number of variants in a full chunk."""
        return self.piece * self._pieces * self.devices

    def chunks(self, n: int) -> Iterator[Chunk]:
        """Chunks of n variants, in order; pieces are assigned to the devices in turn."""
        size = self.most
        for first in range(0, n, size):
            members = min(size, n - first)
            number = np.arange(-(-members // self.piece))
            used = number % self.devices * self._pieces + number // self.devices
            rows = np.full((self.devices * self._pieces, self.piece), first + members - 1)
            own = first + np.arange(number.size * self.piece).reshape(number.size, self.piece)
            rows[used] = np.minimum(own, first + members - 1)
            counts = np.bincount(number % self.devices, minlength=self.devices)
            yield Chunk(rows, counts, used, members)

    def shared(self, tree: Any) -> Any:
        """Copies the arrays that all variants share to every device."""
        place = NamedSharding(self._mesh, SHARED)
        return jax.tree.map(lambda a: jax.device_put(a, place) if is_array(a) else a, tree)

    def placed(self, each: Any, chunk: Chunk) -> Any:
        """Transfers a chunk's rows of arrays (n, ...) to their devices."""
        place = NamedSharding(self._mesh, SPLIT)
        return jax.tree.map(lambda a: jax.device_put(np.asarray(a)[chunk.rows], place), each)

    def run(self, function: Callable[..., Any], shared: Any, chunk: Chunk, each: Any) -> Any:
        """function(shared, *row) for a chunk; `each` contains pytrees from `placed` or `run`. Results stay on devices.

        The function must be pure and defined at module level: its identity is the key of the compiled program.
        """
        counts = jax.device_put(chunk.counts, NamedSharding(self._mesh, SPLIT))
        return _on_devices(function, self._mesh, shared, counts, each)

    def taken(self, out: Any, chunk: Chunk) -> Any:
        """Transfers results of `run` to the host, in the order of the variants."""

        def rows(a: Array) -> NDArray[Any]:
            whole = np.asarray(a)[chunk.used]
            return whole.reshape(-1, *whole.shape[2:])[: chunk.members]

        return jax.tree.map(rows, out)

    def over(
        self, work: Callable[[Chunk], Any], n: int, threads: int = 1, progress: Callable[[int, int], None] | None = None
    ) -> Any:
        """Applies `work` (chunk to pytree of host arrays) to all chunks of n variants, and concatenates the results.

        Several threads use all cores even if the CPU is a single JAX device. `progress` is called with the number of
        completed variants and n.
        """
        done = 0

        def one(chunk: Chunk) -> Any:
            nonlocal done
            got = work(chunk)
            done += chunk.members
            if progress is not None:
                progress(done, n)
            return got

        chunks = self.chunks(n)
        parts = [one(next(chunks))]  # compiles
        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                parts += pool.map(one, chunks)
        else:
            parts += map(one, chunks)
        return parts[0] if len(parts) == 1 else jax.tree.map(lambda *a: np.concatenate(a), *parts)


def is_array(a: Any) -> bool:
    """Whether `a` is an array of JAX or NumPy."""
    return isinstance(a, jax.Array | np.ndarray | np.generic)


def shard_over(mesh: Mesh, function: Callable[..., Any], shared: Any, each: tuple[Any, ...], out: Any = SPLIT) -> Any:
    """Runs function(shared, *each) on every device of a mesh over `AXIS` with its rows, within a compiled program.

    Leaves of `shared` that are not arrays are static. The leading axis of arrays in `each` is distributed over the
    devices; `out` is the partition of the result.
    """
    arrays, fixed = eqx.partition(shared, eqx.is_array)
    # Loop carries differ between devices, so the check of varying axes is disabled.
    return jax.shard_map(
        lambda own, *rows: function(eqx.combine(own, fixed), *rows),
        mesh=mesh,
        in_specs=(SHARED, *[SPLIT] * len(each)),
        out_specs=out,
        check_vma=False,
    )(arrays, *each)
