"""Many variants of a treatment: grids over its amounts, and batches of treatments of the same form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike
from numpy.typing import NDArray

from fitting.treatments import KINDS, Treatment
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene


class VariantBatch(NamedTuple):
    """Variants that share a scene and the form of their treatment."""

    scene: Scene
    treatment: Treatment  # prepared for the scene; its own amounts do not matter
    amounts: Floats  # (n, k), SI units, in the order of the treatment's names
    places: NDArray[np.int64]  # (n,) index of each in the whole study


def grid(treatment: str | Treatment, amounts: Mapping[str, ArrayLike] | None = None, /, **more: ArrayLike) -> Treatment:
    """One treatment with all combinations of amounts as a batch, the last amount varying fastest.

        grid("tibial_tuberosity_transfer", medialisation=np.linspace(0, 0.020, 21), distalisation=[0, 0.005])

    Args:
        treatment: a name in `treatments.KINDS`, or a treatment whose own amounts are used where none are given here.
        amounts: values (SI units) by name, either as in the treatment's `names` or its last part; also as keywords.
        **more: see `amounts`.

    Raises:
        InputError: no such treatment or amount, no values, values that are not finite.
    """
    given = {**(amounts or {}), **more}
    if isinstance(treatment, str):
        treatment = Treatment.of(treatment, dict.fromkeys(given, 0.0))
    names = treatment.names
    axes = []
    for name, value in zip(names, treatment.values, strict=True):
        short = name.rpartition(".")[2]
        key = next((k for k in (name, short) if k in given), None)
        values = np.atleast_1d(np.asarray(given.pop(key) if key else value, dtype=np.float64))
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise InputError(f"found {values.tolist()}", where=f"grid: {name}", expected="a list of finite numbers")
        axes.append(values)
    if given:
        raise InputError(f"no amount {next(iter(given))!r}", where="grid", expected=f"one of: {', '.join(names)}")
    mesh = np.meshgrid(*axes, indexing="ij")
    return treatment.with_values([jnp.asarray(a.ravel(), dtype=float) for a in mesh])


def combinations(shown: Mapping[str, Mapping[str, Sequence[float]]]) -> Treatment:
    """All combinations of amounts of one treatment, or of several in sequence. Raises InputError as `grid` does.

    Values are given by the treatment's name and the amount's, in the units shown to readers: mm, degrees and percent.
    """
    whole, axes = Treatment(), {}
    for kind, amounts in shown.items():
        whole = whole.then(Treatment.of(kind, dict.fromkeys(amounts, 0.0)))
        for name, values in amounts.items():
            axes[f"{kind}.{name}"] = KINDS[kind].amounts[name].from_shown(values)
    return grid(whole, axes)


def batches(scenes: Sequence[Scene], variants: Treatment | Sequence[Treatment] | None) -> list[VariantBatch]:
    """Combines every scene with every variant, batched by scene and form; scenes vary slowest.

    Raises InputError if there are no scenes or variants, one is no treatment, or a scene lacks what is to be changed.
    """
    listed = [variants or Treatment()] if isinstance(variants, Treatment | None) else list(variants)
    if not scenes or not listed:
        raise InputError("nothing to predict", where="predict", expected="at least one scene and one treatment")
    if stray := [t for t in listed if not isinstance(t, Treatment)]:
        raise InputError(f"found {stray[0]!r}", where="variants", expected="treatments: Treatment.of(...) or grid(...)")
    forms: dict[tuple, list[tuple[Treatment, Floats, NDArray[np.int64]]]] = {}
    count = 0
    for treatment in listed:
        amounts = amounts_of(treatment)
        places = count + np.arange(len(amounts))
        count += len(amounts)
        forms.setdefault(treatment.form, []).append((treatment, amounts, places))
    out = []
    for i, scene in enumerate(scenes):
        for alike in forms.values():
            amounts = np.concatenate([a for _, a, _ in alike])
            places = i * count + np.concatenate([p for *_, p in alike])
            bare = alike[0][0].with_values([jnp.asarray(0.0, dtype=float) for _ in alike[0][0].values])
            out.append(VariantBatch(scene, bare.prepared(scene), amounts, places))
    return out


def amounts_of(treatment: Treatment) -> Floats:
    """Amounts (n, k), one row per variant; n = 1 for scalars. Raises InputError for amounts of several lengths."""
    columns = [np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in treatment.values]
    if not columns:
        return np.zeros((1, 0))
    longest = max(c.size for c in columns)
    if any(c.ndim != 1 or c.size not in (1, longest) for c in columns):
        shapes = ", ".join(str(c.shape) for c in columns)
        expected = "one length; see fitting.prediction.variants.grid"
        raise InputError(f"amounts of shapes {shapes}", where="variants", expected=expected)
    return np.stack([np.broadcast_to(c, longest) for c in columns], axis=1)
