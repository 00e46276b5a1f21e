"""`predict`: simulates treatments in one batch, and propagates an estimate's uncertainty to their outcomes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitting.coverage import NOT_KNOWN, Coverage
from fitting.prediction.members import MemberPrograms, Members, Recipe, run
from fitting.prediction.outcomes import MEASURES, Groove
from fitting.prediction.untreated import untrusted_starts
from fitting.prediction.variants import VariantBatch, batches
from fitting.treatments import Treatment
from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.devices import Devices, chosen_devices
from pftwin.dynamics.frame_states import substeps_for
from pftwin.dynamics.status import FLAGS
from pftwin.model.measured import SYNTHETIC
from pftwin.model.scene import Scene, check
from pftwin.results.tracking import DISLOCATED
from pftwin.results.verdict import INVALID, Verdict, is_invalid, verdict_of_counts

if TYPE_CHECKING:
    from xarray import Dataset

STEP = 5e-4  # [s]; for its accuracy see docs/accuracy.md
CHUNK = 256  # variants for which one step of the whole chunk stays in a core's cache
_COURSE_LIMIT = 4096  # most variants whose trajectories are stored: some 50 MB per thousand


class Fitted(Protocol):
    """The part of `fitting.Estimate` that a prediction needs. An estimate class of your own inherits from it."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats

    @property
    def apply(self) -> Callable[..., Scene]:
        """A function of a scene, and optionally of other values (p,), that returns the scene with them."""
        ...

    def samples(self, count: int, seed: int = 0) -> Floats:
        """Parameters (count, p) drawn from the estimate's uncertainty."""
        ...

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kind of each parameter: `fitting.parameters.REQUESTED`, or the kind of nuisance; may be empty."""
        return ()

    @property
    def coverage(self) -> Coverage:
        """Measured coverage of intervals, bands and plans from such estimates, in words."""
        return NOT_KNOWN

    @property
    def synthetic(self) -> bool:
        """Whether the measurements that it was fitted to are synthetic."""
        return False

    @property
    def source(self) -> str:
        """Source of the measurements that it was fitted to."""
        return ""

    @property
    def doubts(self) -> Sequence[str]:
        """Reasons to distrust it; any makes it INVALID."""
        return ()

    @property
    def objection(self) -> str:
        """ "INVALID" and why, so that nothing may be concluded from it; empty if it is valid."""
        return f"{INVALID}: {'; '.join(self.doubts)}" if self.doubts else ""


def predict(
    scenes: Scene | Sequence[Scene],
    variants: Treatment | Sequence[Treatment] | None = None,
    estimate: Fitted | None = None,
    *,
    samples: int = 0,
    seed: int = 0,
    dt: float | None = None,
    threshold: float = DISLOCATED,
    trajectories: bool = False,
    chunk: int = CHUNK,
    devices: Devices = "all",
    progress: Callable[[int, int], None] | None = None,
) -> Dataset:
    """Predicts outcomes of treatments.

        predict(scene, grid("tibial_tuberosity_transfer", medialisation=np.linspace(0, 0.02, 21)), estimate, samples=50)

    Args:
        scenes: untreated, with nominal parameters; every scene is combined with every variant.
        variants: a treatment, a grid of one (`fitting.prediction.variants.grid`), or a list of any of these; None: no
            treatment.
        estimate: parameters that replace the scenes' own before any treatment.
        samples: draws from the estimate's uncertainty, in addition to the estimate itself; the same for all variants.
        seed: of the draws.
        dt: longest time step [s], then used for all. By default 0.5 ms, and a quarter of that where the estimated error
            is too large.
        threshold: distance from the groove's bottom beyond which the button counts as dislocated [m].
        trajectories: whether the dataset also contains paths, tilt and facet forces over time.
        chunk: most variants simulated together on a device; it limits the memory, and does not change the results.
        devices: over which variants are distributed, as in `pftwin.simulate_batch`.
        progress: called with the number of simulations done and of all.

    Returns:
        A dataset over `variant` (and `sample`, of which 0 is the estimate itself), in SI units and degrees, with the
        amounts as coordinates, every outcome of `fitting.prediction.outcomes.MEASURES`, `status_frames` (frames with
        each status) and `failed`. Variants and draws with an INVALID motion, or that cannot be simulated, have `failed`
        set and contain NaN; no error is raised. If the untreated scene starts INVALID (it has no equilibrium, nothing
        pulls the patella upward, or its equilibrium is far from the recorded start), all its variants are INVALID,
        although `pftwin.simulate` of a treated scene does not check the start. So are all variants of a draw whose own
        untreated scene starts INVALID.

    Raises:
        InputError: no scene or treatment; a scene that lacks what is to be changed or estimated; samples without an
            estimate; numbers out of range.
    """
    given = [scenes] if isinstance(scenes, Scene) else list(scenes)
    step, care = (STEP, True) if dt is None else (dt, False)
    check_draws(samples, estimate)
    _check_numbers(chunk, step, threshold)
    chosen_devices(devices)
    if stray := [s for s in given if not isinstance(s, Scene)]:
        raise InputError(f"found {stray[0]!r}", where="scenes", expected="scenes")
    groups = batches(given, variants)
    total = sum(len(b.places) for b in groups)
    if trajectories and (many := total * (1 + samples)) > _COURSE_LIMIT:
        expected, remedy = f"at most {_COURSE_LIMIT}", "outcomes first, then the trajectories of a few variants"
        raise InputError(f"trajectories of {many} members", where="trajectories", expected=expected, remedy=remedy)
    thetas = estimate_and_draws(estimate, samples, seed)
    done, found, invalid = 0, [], []
    for batch in groups:

        def counted(here: int, _: int, before: int = done) -> None:
            if progress is not None:
                progress(before + here, total * len(thetas))

        recipe = _recipe(batch, estimate, step, threshold, trajectories)
        amounts = np.repeat(batch.amounts, len(thetas), axis=0)  # variants by samples, samples varying fastest
        members = np.tile(thetas, (len(batch.amounts), 1))
        programs = MemberPrograms(recipe, len(amounts), chunk, devices)
        invalid.append(untrusted_starts(programs, batch.scene, thetas))
        found.append(run(programs, amounts, members, counted, care=care))
        done += len(amounts)
    return dataset(groups, found, estimate, thetas, invalid, dt=step, threshold=threshold)


def _check_numbers(chunk: int, dt: float, threshold: float) -> None:
    """Raises InputError for a chunk that is no count, or for a step or threshold that is not positive."""
    if not (isinstance(chunk, int) and chunk >= 1):
        raise InputError(f"found {chunk!r}", where="chunk", expected="a whole number, at least 1")
    for name, value in (("dt", dt), ("threshold", threshold)):
        if not (isinstance(value, int | float) and 0 < value < np.inf):
            raise InputError(f"found {value!r}", where=name, expected="a positive number")


def _recipe(batch: VariantBatch, estimate: Fitted | None, dt: float, threshold: float, trajectories: bool) -> Recipe:
    """How to simulate a batch. Raises InputError for a scene that fails `check` or lacks the estimate's parameters."""
    scene, fitted = batch.scene, None if estimate is None else estimate.apply
    check(scene)
    if fitted is not None:
        check(fitted(scene))
    substeps = jnp.asarray(substeps_for(scene.motion.frame_interval, dt))
    return Recipe(scene, batch.treatment, fitted, Groove.of(scene), substeps, float(threshold), trajectories)


def estimate_and_draws(estimate: Fitted | None, samples: int, seed: int) -> Floats:
    """The estimate's values, then draws (1 + samples, p)."""
    if estimate is None:
        return np.zeros((1, 0))
    values = np.asarray(estimate.values, dtype=np.float64)
    drawn = np.asarray(estimate.samples(samples, seed), dtype=np.float64) if samples else np.zeros((0, values.size))
    return np.concatenate([values[None], drawn])


def caveats(estimate: Fitted | None, synthetic: bool) -> list[str]:
    """Caveats of any prediction: doubts about the estimate, and which data are synthetic."""
    said = [] if estimate is None else [f"INVALID estimate: {doubt}" for doubt in estimate.doubts]
    return said + synthetic_parts(estimate, synthetic)


def synthetic_parts(estimate: Fitted | None, synthetic: bool) -> list[str]:
    """Which data of a prediction are synthetic, in words."""
    said = [SYNTHETIC] if synthetic else []
    learned = estimate is not None and estimate.synthetic
    return [*said, "the parameters were estimated from synthetic measurements"] if learned else said


def check_draws(samples: int, estimate: Fitted | None) -> None:
    """Raises InputError for an invalid number of draws, or for draws without an estimate."""
    if not (isinstance(samples, int) and samples >= 0):
        raise InputError(f"found {samples!r}", where="samples", expected="a whole number, at least 0")
    if samples and estimate is None:
        raise InputError("samples without an estimate", where="samples", remedy="pass an estimate: estimate=...")


Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]
_DEGREES = 180 / np.pi
_COURSES = {
    "sphere_center": ("m", "button's sphere centre in the femur frame"),
    "groove_offset": ("m", "sphere centre off the groove's bottom, lateral positive"),
    "patella_tilt": ("rad", "patellar tilt, lateral positive"),
    "force_medial": ("N", "normal force on the medial facet"),
    "force_lateral": ("N", "normal force on the lateral facet"),
}


def dataset(
    batches: list[VariantBatch],
    found: list[Members],
    estimate: Fitted | None,
    thetas: Floats,
    invalid: list[list[tuple[str, ...]]],
    **settings: float,
) -> Dataset:
    """The dataset of members, which stand batch by batch, variants by samples.

    `invalid`: for each batch, why no motion of its scene can be trusted, with the estimate's values and each draw's.
    """
    from xarray import Dataset

    places = np.concatenate([b.places for b in batches])
    order, many = np.argsort(places), len(thetas)
    sampled = many > 1
    axes = ("variant", "sample") if sampled else ("variant",)

    def gathered(parts: list[Any]) -> Any:
        a = np.concatenate([p.reshape(len(b.places), many, *p.shape[1:]) for b, p in zip(batches, parts, strict=True)])
        return a[order] if sampled else a[order][:, 0]

    counted = [(m, b.scene.motion.times.size, why[0]) for b, m, why in zip(batches, found, invalid, strict=True)]
    failed = gathered(
        [
            ~m.sensible | is_invalid(m.flags, frames) | np.resize([bool(why or own) for own in each], m.sensible.size)
            for (m, frames, why), each in zip(counted, invalid, strict=True)
        ]
    )
    variables: Variables = {}
    for name, about in MEASURES.items():
        values, unit = _shown(gathered([m.outcomes[name] for m in found]), about.unit)
        variables[name] = _named(axes, np.where(failed, np.nan, values), about.long_name, unit)
    variables["failed"] = _named(axes, failed, "whether the motion is INVALID: see verdict", "1")
    flags, meanings = gathered([m.flags for m in found]), [f.describe() for f in FLAGS]
    variables["status_frames"] = _named((*axes, "flag"), flags, "recorded frames with each status", "1", flags=meanings)
    for name in found[0].courses:
        values, unit = _shown(gathered([m.courses[name] for m in found]), _COURSES[name][0])
        last = ("axis",) if name == "sphere_center" else ()
        variables[name] = _named((*axes, "time", *last), values, _COURSES[name][1], unit)
    coordinates = _coordinates(batches, order, len(places), bool(found[0].courses))
    words = np.array([said for m, frames, why in counted for said in _verdicts(m, frames, why, many)])
    coordinates["verdict"] = _named(("variant",), words[order], "verdict on the motion")
    more = {}
    if estimate is not None:
        coordinates["parameter"] = _named(("parameter",), list(estimate.names), "estimated parameter")
        coordinates["parameter_unit"] = _named(("parameter",), list(estimate.units), "its unit")
        if estimate.kinds:
            coordinates["parameter_kind"] = _named(("parameter",), list(estimate.kinds), "what it was fitted as")
        along = ("sample", "parameter") if sampled else ("parameter",)
        used = thetas if sampled else thetas[0]
        variables["parameters"] = _named(along, used, "values that were used", "as parameter_unit")
        if sampled:
            more = {"coverage": estimate.coverage.bands, "coverage_briefly": estimate.coverage.briefly}
    if sampled:
        coordinates["sample"] = _named(("sample",), np.arange(many), "0: the estimate; then draws", "1")
    return Dataset(variables, coordinates, {**_attributes(batches, estimate, settings), **more})


def _named(axes: tuple[str, ...], values: Any, long_name: str, unit: str = "", **more: Any) -> Any:
    """A variable with its meaning, and its unit if it has one."""
    return axes, values, {**({"units": unit} if unit else {}), "long_name": long_name, **more}


def _coordinates(batches: list[VariantBatch], order: NDArray[np.int64], count: int, timed: bool) -> Variables:
    """The variant axis: number, scene, words, and each amount; 0 if a variant's treatment has no such amount."""
    words, scenes = [], []
    amounts: dict[str, tuple[NDArray[np.float64], str]] = {}
    for batch in batches:
        rows = slice(len(words), len(words) + len(batch.places))
        words += [batch.treatment.with_values(row).describe() for row in batch.amounts]
        scenes += [batch.scene.name] * len(batch.places)
        for name, way, column in zip(batch.treatment.names, batch.treatment.ways, batch.amounts.T, strict=True):
            values, unit = _shown(column, way.unit)
            amounts.setdefault(name.replace(".", "_"), (np.zeros(count), unit))[0][rows] = values
    along = ("variant",)
    out: Variables = {
        "variant": _named(along, np.arange(count), "variant", "1"),
        "scene": _named(along, np.array(scenes)[order], "scene"),
        "treatment": _named(along, np.array(words)[order], "treatment"),
        "flag": _named(("flag",), [str(f.name).lower() for f in FLAGS], "status flag"),
    }
    for name, (values, unit) in amounts.items():
        out[name] = _named(along, values[order], name.replace("_", " "), unit)
    if timed:
        out["time"] = _named(("time",), batches[0].scene.motion.times, "time", "s")
        out["axis"] = _named(("axis",), ["x", "y", "z"], "femur axis: x proximal, y lateral, z anterior", "1")
    return out


def _verdicts(found: Members, frames: int, why: tuple[str, ...], many: int) -> list[str]:
    """Of every variant, for the estimate itself."""
    own = zip(found.flags[::many], found.sensible[::many], strict=True)
    impossible = ("a parameter has an impossible value",)
    reasons = [verdict_of_counts(counts, frames).reasons if good else impossible for counts, good in own]
    return [Verdict((*said, *why)).describe() for said in reasons]


def _shown(values: NDArray[Any], unit: str) -> tuple[NDArray[Any], str]:
    """Converts angles to degrees; all else is unchanged."""
    return (_DEGREES * values, "deg") if unit == "rad" else (values, unit)


def _attributes(batches: list[VariantBatch], estimate: Fitted | None, settings: dict[str, float]) -> dict[str, Any]:
    import jax

    from pftwin import __version__

    names = list(dict.fromkeys(b.scene.name for b in batches))
    computed = any(b.scene.synthetic for b in batches)
    said = caveats(estimate, computed)
    return {
        "title": f"predicted outcomes: {', '.join(names)}",
        "source": f"pftwin {__version__}",
        "jax_version": jax.__version__,
        "parameters": "of the scene" if estimate is None else f"estimated from {estimate.source or 'measurements'}",
        "synthetic": int(computed or (estimate is not None and estimate.synthetic)),
        **({"note": "; ".join(said)} if said else {}),
        **({"objection": estimate.objection} if estimate is not None and estimate.objection else {}),
        **{k: float(v) for k, v in settings.items()},
    }
