"""Run as a process of its own, with some CPU devices: what a batch gives by devices, chunks and order, as JSON."""

from __future__ import annotations

import json
import sys
from typing import Any

import equinox as eqx
import numpy as np

COUNT = 130  # two pieces, the second hardly begun


def bent(scene: Any, row: Any) -> Any:
    """The quadriceps' stiffness and slack length."""
    tendon = scene.effects[1]
    return scene.with_effect(eqx.tree_at(lambda t: (t.stiffness, t.slack_length), tendon, (row[0], row[1])))


def rows_of(count: int = COUNT) -> np.ndarray:
    random = np.random.default_rng(4)
    return np.stack([random.uniform(140, 170, count), random.uniform(0.140, 0.146, count)], axis=1)


def bits(data: Any, members: Any = slice(None)) -> dict[str, str]:
    """All variables, to the last bit."""
    return {str(k): np.ascontiguousarray(v.values[members]).tobytes().hex() for k, v in data.data_vars.items()}


def differences(a: Any, b: Any) -> dict[str, float]:
    """The largest of each variable, as a share of its own size."""
    out = {}
    for name in a.data_vars:
        x, y = (np.asarray(d[name].values, float) for d in (a, b))
        out[str(name)] = float(np.nanmax(np.abs(x - y)) / max(float(np.nanmax(np.abs(x))), 1e-30))
    return out


def main(devices: int, cache: str) -> None:
    import pftwin

    pftwin.configure(cache_dir=cache, cpu_devices=devices)
    from small_scene import small_scene

    scene, values = small_scene(6), rows_of()
    order = np.random.default_rng(5).permutation(COUNT)

    def batch(rows: np.ndarray, **more: Any) -> Any:
        return pftwin.simulate_batch(pftwin.Variants(scene, bent, rows), dt=5e-3, trajectories=True, **more)

    whole = batch(values)
    mixed = bits(batch(values[order]))
    seen = {
        "devices": devices,
        "order": mixed == bits(whole, order),
        "one": differences(whole, batch(values, devices=1)),
        "padding": whole.sizes["variant"],
    }
    seen["bits"] = bits(whole)
    print(json.dumps(seen))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
