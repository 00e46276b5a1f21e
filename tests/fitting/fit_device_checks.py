"""Run as a process of its own, with two CPU devices: what fits find on one and on both, as JSON."""

from __future__ import annotations

import json
import sys

METHODS = {
    "least_squares": {"starts": 3},
    "genetic": {"population": 13, "generations": 4},  # no multiple of two
    "gradient": {"starts": 3, "iterations": 3},
}


def main(cache: str) -> None:
    import pftwin

    pftwin.configure(cache_dir=cache, cpu_devices=2)
    from small_scene import small_scene

    import fitting
    from pftwin.model.measured import Measured

    scene = small_scene(12)
    truth = pftwin.simulate(scene, dt=1 / 600, integrator=pftwin.LinearImplicit()).center
    measured = Measured(scene.motion.times, truth * 1.001)

    def found(method: str, devices: int) -> dict:
        free, options = ("K1", "L2"), METHODS[method]
        estimate = fitting.fit_tendons(scene, measured, method=method, free=free, devices=devices, **options)
        return {"values": estimate.values.tolist(), "iterations": estimate.iterations}

    print(json.dumps({method: [found(method, count) for count in (1, 2)] for method in METHODS}))


if __name__ == "__main__":
    main(sys.argv[1])
