"""Numbers of one knee that are not quite the same in each of its trials: `fit_tendons([...], varies={"L1": 0.5e-3})`.

    value in trial k = shared value + difference k,    difference k ~ N(0, sd)

So trials lend each other strength as far as they are alike: the smaller the standard deviation, the more. The shared
value is the mean of all trials that there might be, and is what is told and carried to other knees; differences are
fitted besides. With a wide standard deviation each trial has a value of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real

import numpy as np

from fitting.nuisance import REACH
from fitting.parameters import BETWEEN_TRIALS, Parameter, Parameters
from pftwin.base.errors import InputError
from pftwin.model.number_place import named_arrays
from pftwin.model.scene import Scene


def with_differences(
    scene: Scene, parameters: Parameters, varies: Mapping[str, float], trials: Sequence[str]
) -> Parameters:
    """The parameters that trials of these names share, and of each that varies, by a standard deviation, differences
    of all trials, at the end; `scene` is the first trial's, with whatever is fitted in it. Raises InputError: a name
    that is not free, or one of many numbers; no standard deviation; a single trial; bounds that leave no room."""
    if not varies:
        return parameters
    if len(trials) < 2:
        raise InputError("a single trial", where="varies", expected="several trials, which differ")
    names = parameters.names
    if strange := [name for name in varies if name not in names]:
        known = [name for name in names if name.startswith(f"{strange[0]}[")] or names
        raise InputError(f"{strange[0]!r} is not free", where="varies", expected=f"some of: {', '.join(known)}")
    items = list(parameters.items)
    for p in parameters.items:
        if p.name in varies:
            sd = _deviation(scene, p, varies[p.name])
            items += [
                Parameter(
                    f"{p.name} difference in {name}",
                    p.place,
                    0.0,
                    -REACH * sd,
                    REACH * sd,
                    (0.0, sd),
                    p.unit,
                    coordinate=True,
                    kind=BETWEEN_TRIALS,
                    trial=trial,
                )
                for trial, name in enumerate(trials)
            ]
    return Parameters(tuple(items))


def _deviation(scene: Scene, p: Parameter, sd: float) -> float:
    """It, if it can be one. Raises InputError: it is no positive number, or the least of the bounds less so many
    deviations is no such quantity."""
    if not (isinstance(sd, Real) and np.isfinite(float(sd)) and float(sd) > 0):
        raise InputError(f"{p.name}: found {sd!r}", where="varies", expected="a positive standard deviation")
    declared = named_arrays(scene)[p.place.names[0].partition("[")[0]].quantity
    if declared is not None and not (declared.holds(p.lower - REACH * sd) and declared.holds(p.upper + REACH * sd)):
        raise InputError(
            f"{p.name}: bounds {p.lower:g} to {p.upper:g} and {REACH:g} deviations of {sd:g} leave room for values"
            " that it cannot have",
            where="varies",
            expected=declared.expected,
            remedy="narrower bounds, or a smaller deviation; what may be zero, such as friction, cannot vary",
        )
    return float(sd)
