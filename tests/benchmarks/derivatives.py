"""What derivatives of a whole trajectory cost beside the trajectory itself."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from pftwin.dynamics.batch.batched import batched
from pftwin.geometry.patch.polynomial import PolynomialPatch
from pftwin.model.scene import Scene
from tests.benchmarks.clock import measure_in_turn
from tests.benchmarks.problem import (
    Setting,
    compiled,
    started_nearby,
    temporary_memory,
    variants,
    with_springs,
)
from tests.benchmarks.row import Row


def forward(scene: Scene, settings: dict[str, Setting], counts: dict[str, tuple[int, ...]]) -> list[Row]:
    """Four columns (K1, L1, K2, L2) in forward mode, the trajectory included, against the trajectory.

    The columns are the outer axis: what they share is computed once, and lies in memory as vectorised loops want it.
    """
    near = started_nearby(scene)
    out = []
    for level, setting in settings.items():
        for count in counts[level]:

            def path(s: Scene, one: jax.Array, setting: Setting = setting) -> Any:
                return setting.path(with_springs(s, one))

            def plain(s: Scene, f: jax.Array) -> Any:
                return batched(lambda one: path(s, one))(f)

            def columns(s: Scene, f: jax.Array, plain: Any = plain) -> Any:
                def push(t: jax.Array) -> Any:
                    return jax.jvp(lambda x: plain(s, x), (f,), (jnp.broadcast_to(t, f.shape),))

                return jax.vmap(push, out_axes=(None, 0))(jnp.eye(4, dtype=f.dtype))

            factors = variants(count)
            a, b = measure_in_turn(compiled(plain, near, factors), compiled(columns, near, factors))
            out.append(
                Row(
                    "forward",
                    f"four-column forward derivative, {count} variants, at {level} mm",
                    b.median / a.median,
                    "x plain",
                    2.5 if count > 1 else None,
                    "at most",
                    note=f"{1e3 * b.median:.1f} ms against {1e3 * a.median:.1f} ms",
                    details={"substeps": setting.substeps, "plain": a.details(), "derivative": b.details()},
                )
            )
    return out


def reverse(scene: Scene, settings: dict[str, Setting]) -> list[Row]:
    """The gradient of one scalar of the path with respect to all of the patch's coefficients."""
    near = started_nearby(scene)
    patch = near.surface
    assert isinstance(patch, PolynomialPatch)
    coefficients = jnp.asarray(patch.coefficients)
    out = []
    for level, setting in settings.items():

        def scalar(s: Scene, c: jax.Array, setting: Setting = setting) -> jax.Array:
            effect = s.contact
            moved = eqx.tree_at(lambda e: e.surface.coefficients, effect, c)
            path = setting.path(s.with_effect(moved))
            return jnp.mean(path.squared_norm())

        def gradient(s: Scene, c: jax.Array, scalar: Any = scalar) -> Any:
            return jax.value_and_grad(lambda x: scalar(s, x))(c)

        a, b = measure_in_turn(compiled(scalar, near, coefficients), compiled(gradient, near, coefficients))
        memory = temporary_memory(gradient, near, coefficients)
        out.append(
            Row(
                "reverse",
                f"gradient with respect to {coefficients.size} patch coefficients, at {level} mm",
                b.median / a.median,
                "x plain",
                6.0,
                "at most",
                note=f"{1e3 * b.median:.1f} ms against {1e3 * a.median:.1f} ms"
                + ("" if memory is None else f", {memory / 2**20:.2f} MiB"),
                details={
                    "substeps": setting.substeps,
                    "memory_bytes": memory,
                    "plain": a.details(),
                    "derivative": b.details(),
                },
            )
        )
    return out
