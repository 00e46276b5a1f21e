"""The energy account of case 1 of the rig by integrator and step: the table of docs/physics.md.

    python -m tests.benchmarks.energy

In millijoules, at the end of the motion; what steps took and what they gave by frames; the remainder at its largest.
"""

from __future__ import annotations

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import pftwin
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.frame_states import frame_states, starting_equilibrium
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2, LinearImplicit
from pftwin.dynamics.observe import observe
from pftwin.model.scene import Scene

SUBSTEPS = (5, 10, 20, 40)  # of frames 10 ms apart


def main() -> None:
    """A row for each integrator and step."""
    scene = pftwin.rig.case(1, contact="P5").unnamed()
    start = eqx.filter_jit(starting_equilibrium)(scene)
    say("| integrator | step | work | change of energy | heat | steps took | steps gave | remainder |")
    say("|---|---:|---:|---:|---:|---:|---:|---:|")
    for integrator in (LinearImplicit(), BDF2()):
        for n in SUBSTEPS:
            change, work, heat, taken = 1e3 * np.asarray(account(scene, start, integrator, jnp.asarray(n)))
            each, left = np.diff(taken), np.abs(change - work + heat + taken).max()
            cells = (work[-1], change[-1], heat[-1], each[each > 0].sum(), -each[each < 0].sum(), left)
            row = " | ".join(f"{v:.3f}" for v in cells)
            say(f"| `{integrator.text}` | {1e3 * scene.motion.frame_interval / n:g} ms | {row} |")


@eqx.filter_jit
def account(scene: Scene, start: Solution, integrator: Integrator, n: jax.Array) -> jax.Array:
    """(4, frames) change of kinetic and stored energy, work, heat, numerical dissipation [J]."""
    path = frame_states(scene, integrator=integrator, substeps=n, start=start, ledger=True)
    seen, ledger = observe(scene, path), path.ledger
    assert ledger is not None
    total = sum(seen.potential_energy.values(), start=seen.kinetic_energy)
    parts = (total - total[0], ledger.work, ledger.heat, ledger.numerical_dissipation(seen.kinetic_energy))
    return jnp.stack(parts)


def say(line: str) -> None:
    """Prints a row at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    pftwin.configure(cache_dir=True)
    main()
