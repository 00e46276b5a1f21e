"""The posterior that `pftwin fit --posterior N` adds to an estimate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from pftwin.base.errors import InputError
from pftwin.cli.terminal import err

if TYPE_CHECKING:
    from fitting.estimate import Estimate
    from fitting.posterior.sampling import Posterior


def check_posterior(objective: str) -> None:
    """Refuses before a fit what could not be sampled after it.

    Raises:
        InputError: an objective that is no likelihood.
        MissingExtraError: blackjax is not installed.
    """
    from fitting.posterior.sampling import accepting

    if objective == "paper":
        raise InputError("the paper's objective is no likelihood", where="--posterior", remedy="--objective likelihood")
    accepting()


def with_posterior(estimate: Estimate, draws: int, seed: int, output: Path) -> Posterior:
    """Samples, with progress on stderr, and writes the estimate's file again with the posterior in it."""
    from fitting.posterior.sampling import sample_posterior
    from pftwin.base.output import written_whole

    with err().status("sampling the posterior ...") as spinner:
        found = sample_posterior(
            estimate,
            draws=draws,
            seed=seed,
            progress=lambda done, of: spinner.update(f"sampling the posterior: {done} of {of} proposals ..."),
        )
    with written_whole(output) as temporary:
        content = {**estimate.to_dict(), "posterior": found.to_dict()}
        temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return found
