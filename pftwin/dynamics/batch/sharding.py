"""A function over a batch, laid over devices: one program for a kind of scene, run chunk by chunk.

Members are computed in pieces of one size, side by side as vector lanes, as `pftwin.dynamics.batch.batched` explains.
Every device loops over its pieces, and their number is not part of the program. So a member's result is the same to the
last bit whatever the chunk size and its place in the batch. For several devices XLA partitions the program with passes
that a single-device program does not need, so results on one device and on several differ by rounding. Incomplete
pieces are padded with copies of the last member; unused pieces are not run.
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

from pftwin.dynamics.batch.batched import ACCELERATED, PIECE

FEW = 16  # members of a piece in a small batch


def piece_for(n: int, platform: str) -> int:
    """How many members are computed side by side: a function of n with few values, so that programs are shared."""
    if platform != "cpu":
        return min(ACCELERATED, max(FEW, 1 << (n - 1).bit_length()))
    return FEW if n <= 2 * FEW else PIECE


@eqx.filter_jit
def _on_devices(function: Callable[..., Any], mesh: Mesh, shared: Any, counts: Array, each: Any) -> Any:
    """function(shared, *row) for the rows of each, (devices * pieces, members, ...); `counts` pieces of each device."""

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
    """Members that are computed together, and where each is computed."""

    rows: NDArray[np.int64]  # (devices * pieces, piece) which member is where
    counts: NDArray[np.int64]  # (devices,) pieces of each that are run
    used: NDArray[np.int64]  # pieces in the order of their members
    members: int


class Sharding:
    """Devices, and how members are distributed over them.

    Args:
        devices: of one kind.
        piece: members computed side by side.
        chunk: most members computed before results return to the host, at least a piece for each device.
    """

    def __init__(self, devices: tuple[Any, ...], piece: int, chunk: int) -> None:
        self._mesh = Mesh(np.array(devices), (AXIS,))
        self.devices, self.piece = len(devices), piece
        self._pieces = max(1, chunk // (piece * len(devices)))

    @property
    def most(self) -> int:
        """Members of a full chunk."""
        return self.piece * self._pieces * self.devices

    def chunks(self, n: int) -> Iterator[Chunk]:
        """All members, in order; pieces go to the devices in turn."""
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
        """Copies what all members share to every device."""
        place = NamedSharding(self._mesh, SHARED)
        return jax.tree.map(lambda a: jax.device_put(a, place) if is_array(a) else a, tree)

    def placed(self, each: Any, chunk: Chunk) -> Any:
        """A chunk's rows of arrays (n, ...), each on its device."""
        place = NamedSharding(self._mesh, SPLIT)
        return jax.tree.map(lambda a: jax.device_put(np.asarray(a)[chunk.rows], place), each)

    def run(self, function: Callable[..., Any], shared: Any, chunk: Chunk, each: Any) -> Any:
        """function(shared, *row) of a chunk, left on the devices, for trees from `placed` or of `run`'s answers.

        The function is pure, and defined at module level: its identity is the key of the compiled program.
        """
        counts = jax.device_put(chunk.counts, NamedSharding(self._mesh, SPLIT))
        return _on_devices(function, self._mesh, shared, counts, each)

    def taken(self, out: Any, chunk: Chunk) -> Any:
        """The results of `run` on the host, in the members' order."""

        def rows(a: Array) -> NDArray[Any]:
            whole = np.asarray(a)[chunk.used]
            return whole.reshape(-1, *whole.shape[2:])[: chunk.members]

        return jax.tree.map(rows, out)

    def over(
        self, work: Callable[[Chunk], Any], n: int, threads: int = 1, progress: Callable[[int, int], None] | None = None
    ) -> Any:
        """The results of `work`, from a chunk to a tree of arrays on the host, for all chunks of n members, in one.

        So many threads use all cores even where JAX counts the CPU as one device. `progress` is told the number of
        members done and of all.
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
    """Whether something is an array of JAX or NumPy."""
    return isinstance(a, jax.Array | np.ndarray | np.generic)


AXIS = "batch"
SHARED, SPLIT = PartitionSpec(), PartitionSpec(AXIS)


def shard_over(mesh: Mesh, function: Callable[..., Any], shared: Any, each: tuple[Any, ...], out: Any = SPLIT) -> Any:
    """function(shared, *each) on every device of a mesh over `AXIS` with its own rows, within a compiled program.

    Leaves of `shared` that are not arrays stay static. The leading axis of arrays in `each` is distributed over the
    devices; `out` says how the result's axes are.
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
