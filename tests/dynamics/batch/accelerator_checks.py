"""Run as a process of its own: a batch on the CPU beside the same batch on an accelerator, as JSON."""

from __future__ import annotations

import json
import sys
from typing import Any


def main(there: str, precision: str, cache: str) -> None:
    import pftwin

    pftwin.configure(cache_dir=cache, float64=precision == "float64")
    import jax
    from batch_checks import bent, differences, rows_of
    from small_scene import small_scene

    many = pftwin.Variants(small_scene(6), bent, rows_of(40))

    def batch(devices: list[Any]) -> Any:
        found = pftwin.simulate_batch(many, devices=devices, dt=2e-3, trajectories=True, care=False)
        return found.drop_vars("equilibrium_residual")  # rounding itself

    here, away = batch(jax.devices("cpu")[:1]), batch(jax.devices(there)[:1])
    apart = differences(here, away)
    seen = {
        "dtype": str(here["sphere_center"].dtype),
        "status": max(apart[k] for k in ("status", "status_frames", "failed", "frame_status")),
        "differences": apart,
    }
    print(json.dumps(seen))


if __name__ == "__main__":
    main(*sys.argv[1:])
