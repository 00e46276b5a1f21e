"""A posterior as an xarray Dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.posterior.sampling import Posterior


def dataset(posterior: Posterior) -> Dataset:
    """Draws over (chain, draw, parameter), with the estimate and the diagnostics; SI units."""
    from xarray import Dataset

    from pftwin import __version__

    p, e = posterior, posterior.estimate
    chains, draws, _ = p.draws.shape
    own = {"units": "as parameter_unit"}
    by = ("parameter",)
    variables = {
        "theta": (("chain", "draw", "parameter"), p.draws, {**own, "long_name": "draws of the parameters"}),
        "log_density": (("chain", "draw"), p.log_density, {"units": "1", "long_name": "log density up to a constant"}),
        "acceptance": (("chain",), p.acceptance, {"units": "1", "long_name": "share of accepted proposals"}),
        "r_hat": (by, p.r_hat, {"units": "1", "long_name": "rank-normalised split R-hat"}),
        "effective_sample_size": (by, p.effective, {"units": "1", "long_name": "effective sample size"}),
        "estimate": (by, e.values, {**own, "long_name": "estimate that is checked"}),
        "estimate_standard_deviation": (by, e.standard_deviations, {**own, "long_name": "its standard deviation"}),
    }
    coordinates = {
        "chain": (("chain",), np.arange(chains), {"units": "1", "long_name": "chain"}),
        "draw": (("draw",), np.arange(draws), {"units": "1", "long_name": "draw"}),
        "parameter": (by, list(p.names), {"long_name": "parameter"}),
        "parameter_unit": (by, list(p.units), {"long_name": "its unit"}),
    }
    notes = "; ".join(p.remarks())
    attributes = {
        "title": f"posterior: {e.scene_name}",
        "source": f"pftwin {__version__}",
        "measurements": e.source,
        "synthetic": int(e.synthetic),
        "tempered": int(p.tempered),
        "seed": p.seed,
        "evaluations": p.evaluations,
        "finding": p.sentence(),
        **({"note": notes} if notes else {}),
    }
    return Dataset(variables, coordinates, attributes)
