"""An estimate in words: its sentence, the summary with all values, and remarks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fitting.programs import unit_of
from fitting.sensors import sensors_in_words
from fitting.uncertainty import SERIAL, in_words
from pftwin.base.quantities import shown
from pftwin.results.verdict import INVALID

if TYPE_CHECKING:
    from fitting.estimate import Estimate

_TIED = 0.7  # correlation with a parameter at a bound that makes up half of another's variance


def sentence(e: Estimate) -> str:
    """The precision of the requested parameters in a sentence, or why it cannot be stated."""
    asked = e.asked
    beyond = ""
    if e.at_bounds:
        unknown = "the precision is not known, and " if e.set_by_bounds else ""
        beyond = f". At a bound: {', '.join(e.at_bounds)}; {unknown}the true value may lie beyond"
        beyond += f"; strongly correlated with it: {', '.join(tied)}" if (tied := _tied_to_bounds(e)) else ""
    if e.invalid:
        unknown = f"The precision of {', '.join(e.names[:asked])} is not known"
        return f"{INVALID}: {'; '.join(e.objections())}. {unknown}{beyond}"
    said = in_words(
        e.names[:asked],
        (e.upper - e.lower)[:asked],
        e.values[:asked],
        e.covariance[:asked, :asked],
        e.channels,
        e.coordinates,
        e.readings,
        e.units[:asked],
        e.set_by_bounds,
    )
    return f"{said}{beyond}. {'' if e.widened or e.draws is not None else 'But '}{e.coverage.intervals}"


def summary(e: Estimate) -> str:
    """A text table of the values, with the remarks."""
    lines = [sentence(e)] if e.invalid else []
    lines.append(f"{e.scene_name}: {e.method}, objective {e.objective} = {e.objective_value:.6g}")
    for i, name in enumerate(e.names):
        low, high = e.intervals[i]
        lines += ["nuisance and differences between trials:"] if name == next(iter(e.auxiliary), None) else []
        mark = f"; {e.bound_mark(name)}" if e.bound_mark(name) else ""
        deviation, interval = f" +- {e.standard_deviations[i]:.2g}", f"95 %: {low:.6g} to {high:.6g}; "
        if name in e.set_by_bounds:
            deviation = interval = ""
        lines.append(
            f"  {name:<12} {e.values[i]:.6g}{deviation} {e.units[i]}  ({interval}nominal {e.nominal[i]:.6g}{mark})"
        )
    for name, values in e.in_trials.items():
        unit = e.units[e.names.index(name)]
        lines += [f"  {name} in {trial}: {value:.6g} +- {sd:.2g} {unit}" for trial, (value, sd) in values.items()]
    lines += [*([] if e.invalid else [sentence(e)]), *remarks(e), f"stopped: {e.reason}"]
    return "\n".join(lines)


def untold(e: Estimate) -> list[str]:
    """Combinations of parameters that the measurements do not determine."""
    if (open_ := e.undetermined).count and not e.invalid:
        found = f"{e.asked - open_.count} of {e.asked} combinations of the requested parameters"
        others = f"the others are hardly known beyond bounds and priors ({', '.join(open_.names)})"
        return [f"the measurements determine {found}; {others}"]
    return []


def remarks(e: Estimate) -> list[str]:
    """Remarks that qualify the values."""
    out = list(e.notes)
    if e.synthetic:
        out.append("the measurements are synthetic")
    for channel in e.channels if e.trial_rmse else ():
        of_each = {name: left[channel] for name, left in e.trial_rmse.items() if channel in left}
        unit = unit_of(channel, e.readings)
        parts = [f"{shown(left, unit, 3)} in {name}" for name, left in of_each.items()]
        out.append(f"residual of {channel}: {', '.join(parts)}")
    out += untold(e)
    if e.serial_correlation > SERIAL:
        out.append(
            f"residuals are autocorrelated ({e.serial_correlation:.2f} from frame to frame), by errors of the "
            "model or by the filter; intervals allow for the correlation, not for a wrong model"
        )
    if e.share < 1:
        out.append(
            f"in addition to the priors, the measurements count as {100 * e.share:.2g} % of as many independent ones"
        )
    if errors := sensors_in_words(e.nuisance):
        out.append(f"allowed for throughout the recording, one standard deviation: {errors}")
    if e.dropped:
        tried = "starts" if e.draws is None else "simulations"
        out.append(f"{e.dropped} of {e.starts} {tried} found no equilibrium or no finite motion")
    return out


def _tied_to_bounds(e: Estimate) -> list[str]:
    """Other requested parameters whose errors are strongly correlated with one that was set by a bound."""
    at, correlation = [e.names.index(name) for name in e.set_by_bounds], np.abs(e.correlation)
    others = [i for i in range(e.asked) if i not in at]
    return [e.names[i] for i in others if np.any(correlation[i, at] > _TIED)]
