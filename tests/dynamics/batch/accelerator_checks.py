"""Run as a process of its own: a batch on the CPU beside the same batch on an accelerator, as JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from typing import Any

import numpy as np

ESTIMATES = {  # each estimated error, and what it is an error of
    "estimated_error_path": "sphere_center",
    "estimated_error_contact_force": "largest_contact_force",
    "estimated_error_medial_facet": "largest_contact_force",
    "estimated_error_lateral_facet": "largest_contact_force",
}


def main(there: str, precision: str, cache: str, contact: str) -> None:
    import pftwin

    pftwin.configure(cache_dir=cache, float64=precision == "float64")
    import jax
    from batch_checks import bent, differences, rows_of
    from small_scene import small_scene

    scene, rows = small_scene(6), rows_of(40)
    if contact != "patch":
        scene, rows = pftwin.rig.case(1, contact=contact), rows[:16]
        scene = replace(scene, motion=replace(scene.motion, n_frames=6))
    many = pftwin.Variants(scene, bent, rows)

    def batch(devices: list[Any]) -> Any:
        found = pftwin.simulate_batch(many, devices=devices, dt=2e-3, trajectories=True, care=False)
        return found.drop_vars("equilibrium_residual")  # rounding itself

    here, away = batch(jax.devices("cpu")[:1]), batch(jax.devices(there)[:1])
    apart = differences(here, away)
    # An estimated error is the difference of two runs: its rounding is relative to their size, not to its own.
    for name, size in ESTIMATES.items():
        most = max(float(np.abs(here[size].values).max()), 1e-30)
        apart[name] *= float(np.abs(here[name].values).max()) / most
    seen = {
        "dtype": str(here["sphere_center"].dtype),
        "status": max(apart[k] for k in ("status", "status_frames", "failed", "frame_status")),
        "differences": apart,
    }
    print(json.dumps(seen))


if __name__ == "__main__":
    main(*sys.argv[1:])
