"""Whether the untreated knee starts INVALID: with an estimate's values, and with each draw of its uncertainty."""

from __future__ import annotations

import jax
import numpy as np

from fitting.prediction.members import MemberPrograms
from pftwin.base.arrays import Floats
from pftwin.dynamics.equilibrium import converged_on_host
from pftwin.dynamics.equilibrium_report import EquilibriumReport, Start, invalid_start, start_offset
from pftwin.dynamics.simulate import settle_first_frame
from pftwin.model.scene import Scene

NO_EQUILIBRIUM = "the untreated knee has no equilibrium to start from"


def reasons_of(scene: Scene, start: EquilibriumReport | Start, *, explained: bool = True) -> tuple[str, ...]:
    """Reasons not to trust any motion of a scene, treated or not, from its untreated equilibrium; `explained` as in
    `invalid_start`."""
    return (*(() if start.converged else (NO_EQUILIBRIUM,)), *invalid_start(scene, start, explained=explained))


def untrusted_start(scene: Scene, neutral: Scene | None = None) -> tuple[str, ...]:
    """As `reasons_of`, with an equilibrium that is searched for as `pftwin.simulate` does.

    `neutral` is the scene after a treatment without effect, whose program is compiled already. Limits are those of
    `scene`, since `neutral` has none.
    Parameters are not checked: draws from an estimate may exceed the limits of parameters.
    """
    found = settle_first_frame((scene if neutral is None else neutral).unnamed())[0].answer
    moved, turned = start_offset(scene, found)
    return reasons_of(scene, Start(bool(converged_on_host(found)), float(moved), float(turned)))


def untrusted_starts(programs: MemberPrograms, scene: Scene, thetas: Floats) -> list[tuple[str, ...]]:
    """As `reasons_of`, for the estimate's values and its draws (1 + draws, p), with the programs of a batch.

    Where the search of a draw fails, it is repeated from the equilibrium of another row; unlike on the live page and in
    `pftwin.simulate`, damped relaxation is tried for the estimate's values alone.
    """
    poses, starts = programs.untreated(thetas)
    lost, settled = np.flatnonzero(~starts.converged), np.flatnonzero(starts.converged)
    if lost.size and settled.size:
        near = jax.tree.map(lambda a: np.repeat(a[settled[:1]], lost.size), poses)
        retried = programs.untreated(thetas[lost], near)[1]
        jax.tree.map(lambda old, new: old.__setitem__(lost, new), starts, retried)
    fitted, found = programs.recipe.fitted, []
    for theta, *start in zip(thetas, *starts, strict=True):
        own = scene if fitted is None else fitted(scene, theta)
        found.append(reasons_of(own, Start(*start), explained=not found))
    if not starts.converged[0]:  # damped relaxation may help, at the price of compiling it
        found[0] = untrusted_start(scene if fitted is None else fitted(scene, thetas[0]))
    return found
