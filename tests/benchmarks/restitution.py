"""What steps leave of a contact's restitution, and how fast the rig's contacts close: tables of docs/physics.md.

    python -m tests.benchmarks.restitution

The patella of the rig, with the rig's law, thrown against a plate (`pftwin.dynamics.rebound`): mean over the places in
a step at which the contact begins, and their range. Then the fastest approach in the rig's cases, as the ledger has it.
"""

from __future__ import annotations

import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium, substeps_for
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.rebound import impact_time, rebound_in_steps, rebound_of_law
from pftwin.model.scene import Scene

INTEGRATORS = (LinearImplicit(), BDF2())
SPEEDS = (0.02, 0.05, 0.24)  # [m/s]; the last after a fall by 3 mm
STEPS_MS = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)
CASES = (1, 2, 3, 4)


def rebounds() -> None:
    """A row for each speed and integrator."""
    scene = pftwin.rig.case(1, contact="P5")
    assert scene.contact is not None
    law, mass = scene.contact.normal_law(), float(scene.patella.mass)
    assert law is not None
    steps = " | ".join(f"{step:g} ms" for step in STEPS_MS)
    _say(f"| approach | impact | law | integrator | {steps} |", "|---:|---:|---:|---|" + "---:|" * len(STEPS_MS))
    for speed in SPEEDS:
        about = f"| {speed:g} m/s | {1e3 * impact_time(law, mass, speed):.1f} ms | {rebound_of_law(law, speed):.2f}"
        for integrator in INTEGRATORS:
            cells = (rebound_in_steps(law, mass, speed, 1e-3 * step, integrator) for step in STEPS_MS)
            _say(f"{about} | `{integrator.text}` | {' | '.join(_cell(c) for c in cells)} |")


def _cell(rebound: np.ndarray) -> str:
    """The mean, and the range where it is wider than the figures shown."""
    low, high = rebound.min(), rebound.max()
    return f"{rebound.mean():.2f}" + (f" ({low:.2f} to {high:.2f})" if high - low > 0.015 else "")


def rig_approaches() -> None:
    """The fastest approach of each case, in steps of 1 ms [m/s]."""
    _say("\n| m/s | " + " | ".join(f"case {n}" for n in CASES) + " |", "|---" + "|---:" * len(CASES) + "|")
    for integrator in INTEGRATORS:
        found = [float(_fastest(pftwin.rig.case(n, contact="P5").unnamed(), integrator, 1e-3)) for n in CASES]
        _say(f"| `{integrator.text}` | " + " | ".join(f"{v:.2g}" for v in found) + " |")


@eqx.filter_jit
def _fastest(scene: Scene, integrator: Integrator, step: float) -> jnp.ndarray:
    n, start = substeps_for(scene.motion.frame_interval, step), starting_equilibrium(scene)
    ledger = frame_states(scene, integrator=integrator, substeps=n, start=start, ledger=True).ledger
    assert ledger is not None
    return ledger.approach[-1]


def _say(*lines: str) -> None:
    for line in lines:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    pftwin.configure(cache_dir=True)
    rebounds()
    rig_approaches()
