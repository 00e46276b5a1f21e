"""`Posterior`: a sampled posterior, compared with the estimate that it checks."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.estimate import Estimate
from fitting.uncertainty import percent
from pftwin.base.arrays import Floats

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.posterior.plots import PosteriorPlots

LEVELS = (0.025, 0.25, 0.5, 0.75, 0.975)
AGREES = 0.15  # largest difference of an interval's ends that confirms it, as a share of its half width
_UNSOLVED = 0.02  # share of unsolved proposals above which there is a remark
_MIXED, _ENOUGH = 1.02, 400  # largest R-hat, least effective draws (Vehtari et al. 2021: 1.01, and 100 per chain)

_PLAIN = (
    *("names", "units", "means", "standard_deviations", "disagreement", "r_hat", "acceptance", "converged"),
    *("tempered", "evaluations", "outside", "unsolved", "seed", "seconds"),
)


@dataclass(eq=False)
class Posterior:
    """Draws from the posterior of p parameters, compared with the estimate; arrays are in the order of `names`."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: Floats  # (chains, draws, p)
    log_density: Floats  # (chains, draws), up to a constant
    acceptance: Floats  # (chains,) share of accepted proposals
    r_hat: Floats  # (p,) rank-normalised split R-hat
    effective: Floats  # (p,) effective sample size in the bulk or in the tails, whichever is smaller
    estimate: Estimate = field(repr=False)
    tempered: bool  # whether it was tempered to the estimate's covariance, for correlated residuals
    evaluations: int
    outside: int  # proposals dropped because they lie beyond the bounds
    unsolved: int  # proposals for which no solution was found
    seed: int
    seconds: float

    @property
    def means(self) -> Floats:
        """Posterior means (p,)."""
        return self.draws.mean(axis=(0, 1))

    @property
    def standard_deviations(self) -> Floats:
        """Standard deviations (p,)."""
        return self.draws.std(axis=(0, 1), ddof=1)

    @property
    def intervals(self) -> Floats:
        """95 % intervals between quantiles (p, 2)."""
        return self.quantiles((LEVELS[0], LEVELS[-1])).T

    def quantiles(self, levels: tuple[float, ...] = LEVELS) -> Floats:
        """Quantiles of the draws (levels, p)."""
        return np.quantile(self.draws, levels, axis=(0, 1))

    @property
    def ratio(self) -> Floats:
        """Standard deviations in units of the estimate's (p,)."""
        return self.standard_deviations / np.maximum(self.estimate.standard_deviations, 1e-300)

    @property
    def disagreement(self) -> Floats:
        """Largest difference of each interval's ends from the estimate's, as a share of its half width (p,)."""
        theirs = self.estimate.intervals
        half = np.maximum(0.5 * (theirs[:, 1] - theirs[:, 0]), 1e-300)
        return np.abs(self.intervals - theirs).max(axis=1) / half

    @property
    def converged(self) -> bool:
        """Whether the chains agree with each other and their effective sample sizes suffice."""
        return bool(self.r_hat.max() <= _MIXED and self.effective.min() >= _ENOUGH)

    def sentence(self) -> str:
        """The comparison in a sentence."""
        if not self.converged:
            return (
                f"the chains have not converged (R-hat {self.r_hat.max():.3f}, {self.effective.min():.0f} effective "
                "draws): take more draws"
            )
        worst = int(np.argmax(self.disagreement))
        off, name = self.disagreement[worst], self.names[worst]
        if off <= AGREES:
            return (
                f"the posterior agrees with the estimate's 95 % intervals within {percent(off)} ({name} the farthest)"
            )
        return (
            f"the posterior differs from the estimate's 95 % intervals by up to {percent(off)} of their half width "
            f"({name}: standard deviation {self.ratio[worst]:.2f} times the estimate's): trust the posterior's"
        )

    def remarks(self) -> list[str]:
        """Remarks that qualify the result."""
        out, e = [], self.estimate
        if e.synthetic:
            out.append("the measurements are synthetic")
        if self.tempered:
            out.append(
                f"neighbouring residuals are correlated ({e.serial_correlation:.2f}): the likelihood is tempered to "
                "the estimate's covariance, so this checks whether intervals are that straight, not the covariance"
            )
        cut = (e.intervals[:, 0] < e.lower) | (e.intervals[:, 1] > e.upper)
        if cut.any():
            out.append(f"the bounds cut the posterior of {', '.join(np.array(self.names)[cut])}")
        if self.unsolved > _UNSOLVED * self.draws[..., 0].size:
            out.append(f"{self.unsolved} proposals had no solution: where the motion jumps, draws may be missing")
        return out

    def summary(self) -> str:
        """A text table."""
        low, _, middle, _, high = self.quantiles()
        lines = [f"{self.estimate.scene_name}: posterior, {self.draws.shape[0]} chains of {self.draws.shape[1]} draws"]
        for i, name in enumerate(self.names):
            lines.append(
                f"  {name:<12} {middle[i]:.6g} (95 %: {low[i]:.6g} to {high[i]:.6g}) {self.units[i]}; standard "
                f"deviation {self.standard_deviations[i]:.2g}, {self.ratio[i]:.2f} times the estimate's; R-hat "
                f"{self.r_hat[i]:.3f}, {self.effective[i]:.0f} effective draws"
            )
        return "\n".join([*lines, self.sentence(), *self.remarks()])

    @property
    def plot(self) -> PosteriorPlots:
        """Figures of this posterior."""
        from fitting.posterior.plots import PosteriorPlots

        return PosteriorPlots(self)

    def to_dict(self) -> dict[str, Any]:
        """Plain values without the draws, for JSON."""
        chains, draws, _ = self.draws.shape
        return {
            **{name: np.asarray(getattr(self, name)).tolist() for name in _PLAIN},
            "chains": chains,
            "draws": draws,
            "levels": list(LEVELS),
            "quantiles": self.quantiles().tolist(),
            "standard_deviations_in_the_estimates": self.ratio.tolist(),
            "effective_sample_size": self.effective.tolist(),
            "sentence": self.sentence(),
            "remarks": self.remarks(),
        }

    def to_dataset(self) -> Dataset:
        """Draws over (chain, draw, parameter), with the estimate and diagnostics; SI units."""
        from xarray import Dataset

        from pftwin import __version__

        e, by = self.estimate, ("parameter",)
        chains, draws, _ = self.draws.shape
        own, one = "as parameter_unit", "1"
        variables = {
            "theta": (("chain", "draw", "parameter"), self.draws, own, "draws of the parameters"),
            "log_density": (("chain", "draw"), self.log_density, one, "log density up to a constant"),
            "acceptance": (("chain",), self.acceptance, one, "share of accepted proposals"),
            "r_hat": (by, self.r_hat, one, "rank-normalised split R-hat"),
            "effective_sample_size": (by, self.effective, one, "effective sample size"),
            "estimate": (by, e.values, own, "estimate that is checked"),
            "estimate_standard_deviation": (by, e.standard_deviations, own, "its standard deviation"),
            "chain": (("chain",), np.arange(chains), one, "chain"),
            "draw": (("draw",), np.arange(draws), one, "draw"),
        }
        coordinates = {
            "parameter": (by, list(self.names), {"long_name": "parameter"}),
            "parameter_unit": (by, list(self.units), {"long_name": "its unit"}),
        }
        notes = "; ".join(self.remarks())
        attributes = {
            "title": f"posterior: {e.scene_name}",
            "source": f"pftwin {__version__}",
            "measurements": e.source,
            "synthetic": int(e.synthetic),
            "tempered": int(self.tempered),
            "seed": self.seed,
            "evaluations": self.evaluations,
            "finding": self.sentence(),
            **({"note": notes} if notes else {}),
        }
        data = {k: (by, v, {"units": unit, "long_name": words}) for k, (by, v, unit, words) in variables.items()}
        return Dataset(data, coordinates, attributes)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the dataset as NetCDF.

        Raises:
            OutputError: if it cannot be written.
        """
        from pftwin.files.result_files import save_dataset

        target = Path(path)
        save_dataset(self.to_dataset(), target)
        return target
