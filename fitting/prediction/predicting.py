"""What treatments would do: grids and lists of them in one batch, an estimate's uncertainty pushed through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from fitting.prediction.course import Groove
from fitting.prediction.members import Members, Recipe, run
from fitting.prediction.variants import VariantBatch, batches
from fitting.treatments import Treatment
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.devices import Devices, chosen_devices
from pftwin.dynamics.frame_states import substeps_for
from pftwin.model.scene import Scene, check
from pftwin.results.tracking import DISLOCATED

if TYPE_CHECKING:
    from xarray import Dataset

STEP = 2.5e-3  # [s]: on case 1 peak forces are 2 % above those at 1 ms; at 5 ms, where the path still is right, 25 %
CHUNK = 256  # members: where a step of the whole chunk stays in a core's cache
_COURSE_LIMIT = 4096  # members whose trajectories are kept: some 50 MB per thousand
Floats = NDArray[np.float64]


class Fitted(Protocol):
    """What a prediction needs of an estimate; `fitting.Estimate` has it."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats

    @property
    def apply(self) -> Callable[..., Scene]:
        """Of a scene, and of values (p,) if others than the estimated ones are meant: the scene with them."""
        ...

    def samples(self, count: int, seed: int = 0) -> Floats:
        """Parameters (count, p) as uncertain as the estimate."""
        ...


def predict(
    scenes: Scene | Sequence[Scene],
    variants: Treatment | Sequence[Treatment] | None = None,
    estimate: Fitted | None = None,
    *,
    samples: int = 0,
    seed: int = 0,
    dt: float = STEP,
    threshold: float = DISLOCATED,
    trajectories: bool = False,
    chunk: int = CHUNK,
    devices: Devices = "all",
    progress: Callable[[int, int], None] | None = None,
) -> Dataset:
    """Outcomes of treatments.

        predict(scene, grid("tibial_tuberosity_transfer", medialisation=np.linspace(0, 0.02, 21)), estimate, samples=50)

    Args:
        scenes: untreated, with nominal parameters; every scene is combined with every variant.
        variants: a treatment, a grid of one (`fitting.prediction.variants.grid`), or a list of any of these; None: no
            treatment.
        estimate: parameters that take the place of the scenes' own before any treatment.
        samples: draws from the estimate's uncertainty, besides the estimate itself. All variants see the same draws.
        seed: of the draws.
        dt: longest time step [s].
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].
        trajectories: whether the dataset holds paths, tilt and facet forces over time as well.
        chunk: most members that are simulated together on a device; it bounds the memory, not the answer.
        devices: over which members are laid, as `pftwin.simulate_batch` has them.
        progress: called with the number of members done and of all.

    Returns:
        A dataset over `variant` (and `sample`, of which 0 is the estimate itself), in SI units and degrees, with the
        amounts as coordinates, every outcome of `fitting.prediction.outcomes.MEASURES`, `status_frames` (frames with
        each status) and `failed`. Members that cannot be simulated are marked and hold NaN; nothing is raised for them.

    Raises:
        InputError: no scene or treatment; a scene without what is to be changed or estimated; samples without an
            estimate; numbers out of range.
    """
    given = [scenes] if isinstance(scenes, Scene) else list(scenes)
    _check(samples, dt, threshold, chunk, estimate)
    chosen_devices(devices)
    if stray := [s for s in given if not isinstance(s, Scene)]:
        raise InputError(f"found {stray[0]!r}", where="scenes", expected="scenes")
    groups = batches(given, variants)
    total = sum(len(b.places) for b in groups)
    if trajectories and total * (1 + samples) > _COURSE_LIMIT:
        raise InputError(
            f"trajectories of {total * (1 + samples)} members",
            where="trajectories",
            expected=f"at most {_COURSE_LIMIT}",
            remedy="outcomes first, then the trajectories of a few variants",
        )
    thetas = _thetas(estimate, samples, seed)
    done, found = 0, []
    for batch in groups:

        def counted(here: int, _: int, before: int = done) -> None:
            if progress is not None:
                progress(before + here, total * len(thetas))

        found.append(_of_batch(batch, estimate, thetas, dt, threshold, trajectories, chunk, devices, counted))
        done += len(batch.places) * len(thetas)
    from fitting.prediction.dataset import dataset

    return dataset(groups, found, estimate, thetas, dt=dt, threshold=threshold)


def _of_batch(
    batch: VariantBatch,
    estimate: Fitted | None,
    thetas: Floats,
    dt: float,
    threshold: float,
    trajectories: bool,
    chunk: int,
    devices: Devices,
    progress: Callable[[int, int], None],
) -> Members:
    """Members in the order variants by samples, samples varying fastest."""
    scene = batch.scene
    check(scene)
    if estimate is not None:
        check(estimate.apply(scene))  # refuses a scene that has no such parameters
    recipe = Recipe(
        scene,
        batch.treatment,
        None if estimate is None else estimate.apply,
        Groove.of(scene),
        substeps_for(scene.motion.frame_interval, dt),
        float(threshold),
        trajectories,
    )
    amounts = np.repeat(batch.amounts, len(thetas), axis=0)
    parameters = np.tile(thetas, (len(batch.amounts), 1))
    return run(recipe, amounts, parameters, chunk, devices, progress)


def _thetas(estimate: Fitted | None, samples: int, seed: int) -> Floats:
    """(1 + samples, p): the estimate, then draws."""
    if estimate is None:
        return np.zeros((1, 0))
    values = np.asarray(estimate.values, dtype=np.float64)
    drawn = np.asarray(estimate.samples(samples, seed), dtype=np.float64) if samples else np.zeros((0, values.size))
    return np.concatenate([values[None], drawn])


def _check(samples: int, dt: float, threshold: float, chunk: int, estimate: Fitted | None) -> None:
    for name, value, least in (("samples", samples, 0), ("chunk", chunk, 1)):
        if not (isinstance(value, int) and value >= least):
            raise InputError(f"found {value!r}", where=name, expected=f"a whole number, at least {least}")
    for name, value in (("dt", dt), ("threshold", threshold)):
        if not (isinstance(value, int | float) and 0 < value < np.inf):
            raise InputError(f"found {value!r}", where=name, expected="a positive number")
    if samples and estimate is None:
        raise InputError("samples of nothing uncertain", where="samples", remedy="predict(..., estimate, samples=...)")
