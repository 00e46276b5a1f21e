"""How often intervals, bands and plans held the truth where it was known (docs/fitting.md): less often than they say.
What is printed beside a 95 % interval or band comes from here, so that no text says more."""

from __future__ import annotations

from typing import NamedTuple


class Coverage(NamedTuple):
    """Of one kind of fits, in words."""

    intervals: str
    bands: str
    plans: str
    briefly: str  # of bands, for figures


_NO_BANDS = "How often bands predicted from such fits hold was not measured"
_NO_PLANS = "how many plans from such fits are safe was not measured"
_NO_WORD = "how often they hold was not measured"

NOT_KNOWN = Coverage("How often intervals of such fits hold was not measured", _NO_BANDS, _NO_PLANS, _NO_WORD)
QUICK = Coverage(
    "95 % intervals of such fits held the truth in 55 to 87 % of repeated experiments on a knee like the twin, and in "
    "28 to 76 % on one that differs from it",
    "95 % bands of the rig's case 1, predicted from fits of case 2, held the truth in 4 % (tilt), 46 % (peak contact "
    "force) and 88 % (lateral offset) of repeated experiments",
    "plans that were safe in nine of ten draws were safe in 5 of 14 plants of the virtual rig",
    "too narrow for a knee",
)
QUICK_WITH_NUISANCE = Coverage(
    "95 % intervals of fits with nuisance 'rig', on 28 plants of the virtual rig, held the truth in 82 of 112 cases "
    "where a force was measured, and in 78 of 112 from positions alone",
    _NO_BANDS,
    _NO_PLANS,
    _NO_WORD,
)
SIMULATIONS = NOT_KNOWN._replace(
    intervals="The twin was taken as exact: how often such intervals hold the truth of a knee that differs was not "
    "measured"
)
SIMULATIONS_WITH_NUISANCE = Coverage(
    "95 % intervals of posteriors with nuisance 'rig', trained once on positions and a force, held the truth in 89 to "
    "100 % of synthetic plants, by parameter and kind of plants; learned in rounds, before springs stiffened in them, "
    "in 23 of 24 cases, and 24 of 24 from positions alone",
    "Bands of 90 % (not 95) of six outcomes of treated knees, predicted from posteriors with nuisance 'rig' that were "
    "trained once on positions and a force, held the truth in 78 to 100 % of synthetic plants, by outcome and kind",
    "plans from posteriors with nuisance 'rig', trained once on positions and a force, were safe in 67 of 73 synthetic "
    "plants where nine of ten draws had to be",
    "bands of 90 % held the truth in 78 to 100 % of synthetic plants",
)


def coverage_of(simulated: bool, besides: bool, trials: bool) -> Coverage:
    """Of fits by simulations or by least squares, with nuisance or without, of several trials or of one."""
    if simulated and trials:
        return NOT_KNOWN
    alone, with_nuisance = (SIMULATIONS, SIMULATIONS_WITH_NUISANCE) if simulated else (QUICK, QUICK_WITH_NUISANCE)
    return with_nuisance if besides else alone
