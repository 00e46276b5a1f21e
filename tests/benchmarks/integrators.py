"""The distance of each integrator's path from a reference's, and ALI3-P's from Newmark's: tables of docs/accuracy.md.

    python -m tests.benchmarks.integrators docs/benchmarks/integrators.json

Distances are of the button's centre in space, in millimetres, rms over the frames of the whole motion.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.base.output import written_whole
from pftwin.base.runtime import describe
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.motion import KneeMotion
from pftwin.model.scene import Scene
from pftwin.results.result import Result

NAMES = ("linear_implicit", "linear_implicit_bdf2", "newmark")
STEPS_MS = (10.0, 5.0, 2.0, 1.0, 0.5)
PAPER_STEPS_MS = (1.0, 0.5, 0.25)
FINEST_MS = 0.025
Row = tuple[str, list[float]]
FRICTION, SLIP_SPEED = 0.1, 1e-3  # mu; [m/s]


def scenes() -> dict[str, tuple[Scene, Result]]:
    """Each scene with its reference."""
    one, two = (pftwin.rig.case(n, contact="P5") for n in (1, 2))
    rough = Friction(jnp.asarray(FRICTION), jnp.asarray(SLIP_SPEED))
    rubbing = one.with_effect(cast(SphereContact, one.effect("contact")).with_friction(rough))
    return {
        "case 1": (one, run(one, "newmark", FINEST_MS)),
        "case 2": (two, run(two, "newmark", FINEST_MS)),
        f"case 1 with friction (mu {FRICTION})": (rubbing, run(rubbing, "linear_implicit", 0.05)),
    }


def run(scene: Scene, name: str, step_ms: float) -> Result:
    """One motion."""
    return pftwin.simulate(scene, integrator=integrator_from_text(name), dt=1e-3 * step_ms)


def distance_mm(one: Result, other: Result) -> float:
    """Of two paths, rms."""
    return float(1e3 * np.sqrt(np.mean(np.sum((one.center - other.center) ** 2, axis=1))))


def against_reference(known: dict[str, tuple[Scene, Result]]) -> Iterator[Row]:
    """A row for each scene and integrator."""
    for case, (scene, reference) in known.items():
        for name in NAMES:
            yield f"{case}, `{name}`", [distance_mm(run(scene, name, step), reference) for step in STEPS_MS]


def paper_formulation(known: dict[str, tuple[Scene, Result]]) -> Iterator[Row]:
    """ALI3-P from Newmark at the same step and from the reference, and its constraints' drift [m]."""
    (one, reference), (two, _) = known["case 1"], known["case 2"]
    recorded = pftwin.rig.recording(1)
    still = KneeMotion.from_poses(None, recorded.tibia.relative_to(recorded.femur))
    fixed = eqx.tree_at(lambda s: s.motion, one, still)
    drifts = []
    for case, scene in (("case 1", one), ("case 1, femur fixed", fixed), ("case 2", two)):
        runs = [run(scene, "ali3p", step) for step in PAPER_STEPS_MS]
        peers = [run(scene, "newmark", step) for step in PAPER_STEPS_MS]
        yield f"{case}, from `newmark` at the same step", [distance_mm(*pair) for pair in zip(runs, peers, strict=True)]
        drifts.append([r.constraint_drift for r in runs])
        if scene is one:
            yield f"{case}, from `newmark` at {FINEST_MS} ms", [distance_mm(r, reference) for r in runs]
    yield "largest drift of a constraint, m", np.max(drifts, axis=0).tolist()


def table(steps: tuple[float, ...], rows: Iterator[Row]) -> list[Row]:
    """Prints the rows as Markdown, as they come, and returns them."""
    sys.stdout.write(
        "\n| mm | " + " | ".join(f"{step:g} ms" for step in steps) + " |\n" + "|---" * (len(steps) + 1) + "|\n"
    )
    found = []
    for label, values in rows:
        sys.stdout.write(f"| {label} | " + " | ".join(f"{v:.2g}" for v in values) + " |\n")
        sys.stdout.flush()
        found.append((label, values))
    return found


def main(target: Path) -> None:
    """Runs all, prints the tables and writes the figures."""
    pftwin.configure(cache_dir=True)
    known = scenes()
    reference = table(STEPS_MS, against_reference(known))
    paper = table(PAPER_STEPS_MS, paper_formulation(known))
    found = {"machine": describe(), "unit": "mm", "reference": reference, "ali3p": paper}
    with written_whole(target) as temporary:
        temporary.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
