"""Run as a process of its own: what this process of several computes, with the small knee's real motions, as JSON."""

from __future__ import annotations

import json
import sys

import numpy as np
from batch_checks import bent, bits, rows_of


def main(index: int, count: int, port: int, folder: str, cache: str) -> None:
    import jax

    import pftwin

    pftwin.configure(cache_dir=cache, cpu_devices=1)
    if count > 1:
        jax.distributed.initialize(f"127.0.0.1:{port}", count, index, heartbeat_timeout_seconds=30)
    from small_scene import small_scene

    scene, done = small_scene(6), []
    found = pftwin.simulate_batch(
        pftwin.Variants(scene, bent, rows_of(600)),
        dt=5e-3,
        trajectories=True,
        parts=folder,
        chunk=120,
        progress=lambda n, _: done.append(n),
    )
    alone = pftwin.simulate(scene, dt=5e-3)
    print(json.dumps({"bits": bits(found), "done": done, "alone": np.asarray(alone.center).tobytes().hex()}))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], sys.argv[5])
