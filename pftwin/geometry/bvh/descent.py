"""Simultaneous breadth-first descent of two trees to the pairs of leaves that pass a test.

A step replaces a pair of nodes by sixteen pairs of their descendants, two levels down in both trees; if one tree is
much deeper, the first steps go four levels down in that tree alone. The sixteen pairs are tested together, and those
that pass are queued. Taking one pair of nodes at a time, each component of the sixteen volumes in one row, is fastest
on a CPU: about 80 ns for sixteen tests. All two-level steps share one table and one loop, which is compiled once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from pftwin.geometry.bvh.loops import Queue, pushed_where, queue_of

Blocks = Array  # (parents, components, children): volumes of nodes' descendants, one component per row
Test = Callable[[Array, Array], Array]  # volumes of both nodes' descendants, (components, m, n) each -> (m, n) bool
TWO = 2  # levels per step in both trees


class LevelStep(NamedTuple):
    """Levels of the two trees before and after a step; a pair of nodes has sixteen pairs of descendants."""

    start: tuple[int, int]
    end: tuple[int, int]

    @property
    def many(self) -> tuple[int, int]:
        """Numbers of descendants of one node, in each tree."""
        return 1 << (self.end[0] - self.start[0]), 1 << (self.end[1] - self.start[1])


class Descendants(NamedTuple):
    """The sixteen pairs below a pair of nodes."""

    a: Array  # (components, m, n)
    b: Array  # same shape
    pair: Callable[[Array], Array]  # packed pair of a lane


class Descent(eqx.Module):
    """The volumes of two trees, arranged for descent; make it once, before a loop."""

    alone: tuple[tuple[Blocks, Blocks], ...]  # for the first steps, four levels down in one tree
    together: tuple[Blocks, Blocks]  # for all further steps, concatenated
    depths: tuple[int, int] = eqx.field(static=True)  # levels below the roots

    @property
    def steps(self) -> tuple[list[LevelStep], list[LevelStep]]:
        """Steps in one tree alone, and the steps in both trees that follow."""
        return steps_down(self.depths)

    @property
    def code(self) -> jnp.dtype:
        """Integer type that can hold a packed pair and two bits."""
        return jnp.dtype(jnp.int32 if sum(self.depths) <= 29 else jnp.int64)

    def below(self, pair: Array, left: Array) -> Descendants:
        """Descendants of a packed pair of nodes that is `left` (1 or more) steps above the leaves."""
        b_level = (self.depths[1] - TWO * left).astype(pair.dtype)
        i, j = pair >> b_level, pair & ((jnp.ones((), pair.dtype) << b_level) - 1)
        _, steps = self.steps
        rows = []
        for k, (node, blocks) in enumerate(zip((i, j), self.together, strict=True)):
            before = np.cumsum([0] + [1 << s.start[k] for s in steps])[:-1].astype(np.int32)
            row = jnp.asarray(before)[len(steps) - left] + node.astype(jnp.int32)
            rows.append(jax.lax.dynamic_index_in_dim(blocks, row, 0, keepdims=False))
        first = (i * 4 << (b_level + TWO)) + j * 4

        def child(lane: Array) -> Array:
            lane = lane.astype(pair.dtype)
            return first + ((lane >> TWO) << (b_level + TWO)) + (lane & 3)

        return Descendants(*side_by_side(*rows), child)


def steps_down(depths: tuple[int, int]) -> tuple[list[LevelStep], list[LevelStep]]:
    """Steps from the top to the leaves of trees of these depths: in the deeper tree alone, then in both."""
    together: list[LevelStep] = []
    a, b = depths
    while a >= TWO and b >= TWO:
        together.append(LevelStep((a - TWO, b - TWO), (a, b)))
        a, b = a - TWO, b - TWO
    alone: list[LevelStep] = []
    while max(a, b) >= 2 * TWO:
        above = (a - 4, b) if a > b else (a, b - 4)
        alone.append(LevelStep(above, (a, b)))
        a, b = above
    return alone[::-1], together[::-1]


def descent(a: Sequence[Array], b: Sequence[Array]) -> Descent:
    """Arranges the volumes of two trees for descent; level l of a tree is (2^l, components)."""
    depths = len(a) - 1, len(b) - 1
    alone, together = steps_down(depths)
    blocks = [[_blocks(x[s.end[k]], s.many[k]) for s in (*alone, *together)] for k, x in enumerate((a, b))]
    n = len(alone)
    empty = [jnp.zeros((1, x[0].shape[1], 4), x[0].dtype) for x in (a, b)]
    stacked = tuple(jnp.concatenate(x[n:]) if together else e for x, e in zip(blocks, empty, strict=True))
    return Descent(tuple(zip(*(x[:n] for x in blocks), strict=True)), stacked, depths)  # pyright: ignore[reportArgumentType]


def _blocks(level: Array, many: int) -> Blocks:
    return jnp.swapaxes(level.reshape(-1, many, level.shape[-1]), 1, 2)


def side_by_side(a: Array, b: Array) -> tuple[Array, Array]:
    """Broadcasts components (k, m) and (l, n) of two nodes' descendants to (k, m, n) and (l, m, n).

    The optimization barrier prevents fusion, so that the test that follows runs on rows of sixteen.
    """
    shape = a.shape[1], b.shape[1]
    wide = jnp.broadcast_to(a[:, :, None], (a.shape[0], *shape)), jnp.broadcast_to(b[:, None, :], (b.shape[0], *shape))
    return jax.lax.optimization_barrier(wide)


def unpacked(pair: Array, b_level: int) -> tuple[Array, Array]:
    """Nodes of both trees from packed pairs: a's node times the number of b's nodes at its level, plus b's node."""
    return (pair >> b_level).astype(jnp.int32), (pair & ((1 << b_level) - 1)).astype(jnp.int32)


def go_down(descent: Descent, test: Test, width: int, stop: int = 0) -> tuple[Queue, Array]:
    """Packed pairs of nodes that pass the test at every step, and whether any was lost for want of capacity.

    `test` is for sixteen pairs of volumes, `width` the capacity for pairs at any level; the last `stop` steps are
    omitted, 0 descends to the leaves.
    """
    alone, together = descent.steps
    top = (alone[0] if alone else together[0]).start if alone or together else descent.depths
    queue = queue_of(width, jnp.arange(1 << sum(top), dtype=descent.code), descent.code)
    lost = queue.overflow
    for step, blocks in zip(alone, descent.alone, strict=True):
        queue = _one_down(step, blocks, queue, test, width)
        lost = lost | queue.overflow
    n = len(together) - stop

    def one_step(k: Array, state: tuple[Queue, Array]) -> tuple[Queue, Array]:
        queue, lost = state
        left = (len(together) - k).astype(jnp.int32)

        def body(q: Array, found: Queue) -> Queue:
            pair = jax.lax.dynamic_index_in_dim(queue.entries, q, 0, keepdims=False)
            below = descent.below(pair, left)
            return pushed_where(found, test(below.a, below.b), below.pair)

        zero = jnp.zeros((), jnp.int32)
        found = jax.lax.fori_loop(zero, queue.length, body, Queue(jnp.zeros_like(queue.entries), zero))
        return found, lost | found.overflow

    if n <= 0:
        return queue, lost
    return jax.lax.fori_loop(jnp.zeros((), jnp.int32), jnp.asarray(n, jnp.int32), one_step, (queue, lost))


def _one_down(step: LevelStep, blocks: tuple[Blocks, Blocks], queue: Queue, test: Test, width: int) -> Queue:
    """One step four levels down in one tree."""
    of_a, of_b = blocks
    n, below = step.many[1], step.end[1]
    shift = n.bit_length() - 1

    def body(k: Array, found: Queue) -> Queue:
        pair = jax.lax.dynamic_index_in_dim(queue.entries, k, 0, keepdims=False)
        i, j = unpacked(pair, step.start[1])
        a, b = side_by_side(*(jax.lax.dynamic_index_in_dim(x, y, 0, keepdims=False) for x, y in ((of_a, i), (of_b, j))))
        first = ((pair >> step.start[1]) * step.many[0] << below) + (j * n).astype(pair.dtype)

        def child(lane: Array) -> Array:
            return first + ((lane >> shift).astype(pair.dtype) << below) + (lane & (n - 1)).astype(pair.dtype)

        return pushed_where(found, test(a, b), child)

    start = queue_of(width, dtype=queue.entries.dtype)
    return jax.lax.fori_loop(jnp.zeros((), jnp.int32), queue.length, body, start)
