"""Measured coverage of intervals, predicted bands and plans, in words (docs/fitting.md), mostly below the nominal one.
Every text that states a 95 % interval or a band takes its caveat from here, so that none claims more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Coverage(NamedTuple):
    """Measured coverage of one kind of fit, in words."""

    intervals: str
    bands: str
    plans: str
    briefly: str  # coverage of bands in a few words, for figures


_NO_BANDS = "How often bands predicted from such fits contain the true value was not measured"
_NO_PLANS = "how many plans from such fits are safe was not measured"
_NO_WORD = "how often they contain the true value was not measured"

NOT_KNOWN = Coverage(
    "How often intervals of such fits contain the true value was not measured", _NO_BANDS, _NO_PLANS, _NO_WORD
)
SEVERAL_TRIALS = NOT_KNOWN._replace(
    intervals="Of posteriors of several trials only those with nuisance 'rig', trained once on three trials with a "
    "force in each, were tested: their 95 % intervals contained the true value in 39 of 40 cases"
)
VARYING = NOT_KNOWN._replace(
    intervals="How often intervals contain the true value was not measured for parameters that differ between trials"
)
QUICK = Coverage(
    "95 % intervals of such fits contained the true value in 55 to 87 % of repeated experiments on a knee like the "
    "twin, and in 28 to 76 % on one that differs from it",
    "95 % bands of the rig's case 1, predicted from fits of case 2, contained the true value in 4 % (tilt), 46 % (peak"
    " contact force) and 88 % (lateral offset) of repeated experiments",
    "plans that were safe in nine of ten draws were safe in 5 of 14 synthetic knees",
    "too narrow for a knee",
)
QUICK_WITH_NUISANCE = Coverage(
    "95 % intervals of fits with nuisance 'rig', on 28 synthetic knees, contained the true value in 82 of "
    "112 cases where a force was measured, and in 78 of 112 from positions alone",
    _NO_BANDS,
    _NO_PLANS,
    _NO_WORD,
)
SIMULATIONS = NOT_KNOWN._replace(
    intervals="The twin was taken as exact: 95 % intervals of such posteriors, trained once on positions and a force, "
    "contained the true value in 50 to 75 % of eight synthetic knees that differ from it, by parameter"
)
SIMULATIONS_WITH_NUISANCE = Coverage(
    "95 % intervals of posteriors with nuisance 'rig', trained once on positions and a force, contained the true value"
    " in 89 to 100 % of synthetic knees, by parameter and kind of knee; learned in rounds, before springs stiffened"
    " in them, in 23 of 24 cases, and 24 of 24 from positions alone",
    "Bands of 90 % (not 95) of six outcomes of treated knees, predicted from posteriors with nuisance 'rig' that were "
    "trained once on positions and a force, contained the true value in 78 to 100 % of synthetic knees, by outcome "
    "and kind",
    "plans from posteriors with nuisance 'rig', trained once on positions and a force, were safe in 67 of 73 synthetic"
    " knees where nine of ten draws had to be",
    "bands of 90 % contained the true value in 78 to 100 % of synthetic knees",
)


def widened_coverage(factors: Mapping[str, float], plants: Mapping[str, int], knee: str) -> Coverage:
    """Coverage of intervals that a calibration widened by factors of parameters, on numbers of plants by kind, which
    were made of the scene `knee`."""
    wider = ", ".join(f"{name} {times:.2g}" for name, times in factors.items())
    knees = ", ".join(f"{count} {kind}" for kind, count in plants.items())
    return NOT_KNOWN._replace(
        intervals=f"95 % intervals are those of the fit times factors ({wider}), with which each contains the true "
        f"value of 95 % of the synthetic knees of each kind ({knees}) that a calibration made of {knee} and found valid"
    )


def coverage_of(simulated: bool, nuisance: bool, trials: bool, varies: bool) -> Coverage:
    """Coverage of a kind of fit: by simulations or a search, with nuisance or without, of several trials or one, with
    parameters that differ between trials or without."""
    if varies:
        return VARYING
    if simulated and trials:
        return SEVERAL_TRIALS
    alone, with_nuisance = (SIMULATIONS, SIMULATIONS_WITH_NUISANCE) if simulated else (QUICK, QUICK_WITH_NUISANCE)
    return with_nuisance if nuisance else alone
