"""One run, a batch of variants, and the static equilibrium, warm."""

from __future__ import annotations

import jax
import numpy as np

import pftwin
from pftwin.base.spatial import Vec3
from pftwin.dynamics.batch.batched import batched
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.model.scene import Scene
from tests.benchmarks.clock import measure
from tests.benchmarks.problem import Setting, compiled, duration, started_nearby, variants, with_springs
from tests.benchmarks.row import Row

ONE_RUN = {"0.01": 200.0, "0.05": 600.0}  # x real time, by rms error in mm
BATCH = {"0.01": 10_000.0, "0.05": 30_000.0}


def one_run(scene: Scene, settings: dict[str, Setting]) -> list[Row]:
    """Equilibrium and trajectory, as a compiled function and through `pftwin.simulate`."""
    out = []
    for level, setting in settings.items():
        dt, integrator = scene.motion.frame_interval / setting.substeps, integrator_from_text(setting.integrator)
        bare = measure(compiled(setting.path, scene))
        public = measure(lambda dt=dt, i=integrator: pftwin.simulate(scene, integrator=i, dt=dt).center)
        for name, times in (("compiled function", bare), ("pftwin.simulate, all results", public)):
            out.append(
                Row(
                    "one run",
                    f"one run with its equilibrium at {level} mm: {name}",
                    duration(scene) / times.median,
                    "x real time",
                    ONE_RUN[level],
                    note=f"{setting.words(scene)}, {1e3 * times.median:.2f} ms",
                    details={"substeps": setting.substeps, **times.details()},
                )
            )
    return out


def equilibrium(scene: Scene) -> list[Row]:
    """From the recorded pose."""
    times = measure(compiled(starting_equilibrium, scene), runs=20)
    public = measure(lambda: pftwin.equilibrium(scene).residual, runs=5)
    return [
        Row("equilibrium", "static equilibrium", 1e3 * times.median, "ms", 10.0, "at most", details=times.details()),
        Row("equilibrium", "the same with its report", 1e3 * public.median, "ms", details=public.details()),
    ]


def batch(scene: Scene, settings: dict[str, Setting], count: int) -> list[Row]:
    """Variants of K1, L1, K2, L2 side by side; the process is meant to have one core."""
    near, factors = started_nearby(scene), variants(count)
    out = []
    for level, setting in settings.items():
        given = compiled(starting_equilibrium, near)()

        def settled(s: Scene, f: jax.Array, setting: Setting = setting) -> Vec3:
            return batched(lambda one: setting.path(with_springs(s, one)))(f)

        def moving(s: Scene, f: jax.Array, start: Solution, setting: Setting = setting) -> Vec3:
            return batched(lambda one: setting.path(with_springs(s, one), start))(f)

        for name, call in (
            ("each from its own equilibrium", compiled(settled, near, factors)),
            ("trajectories alone", compiled(moving, near, factors, given)),
        ):
            times = measure(call, runs=5, seconds=1.0)
            path = np.asarray(call().array())
            lost = int(np.sum(~np.isfinite(path).all(axis=(1, 2))))
            out.append(
                Row(
                    "batch",
                    f"{count} variants, one core, at {level} mm: {name}",
                    count * duration(scene) / times.median,
                    "x real time",
                    BATCH[level],
                    note=f"{setting.words(scene)}, {times.median:.3f} s" + (f", {lost} not finite" if lost else ""),
                    details={"substeps": setting.substeps, "variants": count, "not_finite": lost, **times.details()},
                )
            )
    return out
