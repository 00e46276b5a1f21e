"""Cases run as results, to be looked at: positions, forces, energies and flags of their frames."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from pftwin.base.errors import InputError
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.results.result import Result
from pftwin.studies.hard_cases.batch import batches, built, member, steps_of
from pftwin.studies.hard_cases.case import HardCase
from pftwin.studies.hard_cases.integrators import method_named
from pftwin.studies.hard_cases.knee import RATE
from pftwin.studies.hard_cases.programs import PARAMETERS, compiled, run
from pftwin.studies.hard_cases.starts import starts_of


def results(
    cases: Sequence[HardCase], contact: str = "P5", integrator: str = "linear_implicit"
) -> dict[str, Result | InputError]:
    """What comes out of each case that there is with a kind of contact, in float64: a result, or what refused it.

    Unlike `pftwin.simulate` it lets go, where a case says so, of a patella that is not in equilibrium. The programs and
    the steps are those of `run_matrix`; of several cases at once they are compiled once.
    """
    method, found = method_named(integrator), {}
    with jax.enable_x64(True):
        stacks, refused = batches(cases, contact)
        for batch in stacks:
            starts = starts_of(batch, "float64").chosen
            substeps = [steps_of(c, method) for c in batch.cases]
            forward = compiled(run, True, integrator=integrator_from_text(integrator))
            nothing = jnp.zeros((len(substeps), len(PARAMETERS)))
            ran = jax.device_get(forward(batch.scenes, starts, jnp.asarray(substeps), nothing))
            for k, case in enumerate(batch.cases):
                one = member(ran, k)
                found[case.name] = Result.build(
                    built(case, contact),
                    member(starts, k),
                    one.seen,
                    one.ledger,
                    relaxed=False,
                    settings={"integrator": integrator, "dt_s": 1 / RATE / substeps[k], "substeps": substeps[k]},
                    timing={},
                )
    found.update(refused)
    return {c.name: found[c.name] for c in cases if c.name in found}
