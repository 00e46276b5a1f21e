"""The comparison of methods on the paper's problem: case 2 of the rig as it was measured."""

from __future__ import annotations

import sys

from fitting.evaluation import Evaluator
from fitting.fit import SPRING_PARAMETERS
from fitting.objective import Objective
from fitting.parameters import free_parameters
from fitting.programs import POSITION
from tests.benchmarks.fitting.methods.comparison import Setting, compared
from tests.benchmarks.fitting.methods.meter import Budget
from tests.benchmarks.fitting.methods.table import rows_of
from tests.benchmarks.row import Row

BUDGET = Budget(2000, 2.0)
_QUICK = Budget(200, 0.1)


def rows(seeds: int, quick: bool) -> list[Row]:
    """Every method from every seed."""
    import pftwin

    scene, measured = pftwin.rig.case(2), pftwin.rig.measured(2)
    evaluator = Evaluator(scene, free_parameters(scene, SPRING_PARAMETERS), (POSITION,))
    evaluator.prepare(None)
    setting = Setting(Objective.of(scene, measured, "paper"), evaluator, _QUICK if quick else BUDGET, seeds)
    return rows_of(compared(setting, say=lambda text: print(text, file=sys.stderr, flush=True)))
