"""Simulates a scene's measured channels for many parameter vectors, with derivatives on request, in batches.

A prediction is a pure function of the parameters: each search for equilibrium starts from the nearest of a fixed set
of equilibria, never from the previous iterate's. So a resumed fit gives the same result as an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from fitting import programs
from fitting.parameters import Parameters
from fitting.programs import ORIENTATION, POSITION, columns_of, side_by_side, unit_of
from pftwin.base.arrays import Floats
from pftwin.base.runtime import warn_of_accelerator
from pftwin.base.spatial import Pose
from pftwin.dynamics.batch.devices import Devices, chosen_devices, feeding_threads
from pftwin.dynamics.frame_states import substeps_for
from pftwin.model.scene import Scene

T = TypeVar("T")

CHUNK = 32  # variants in one call by default
_WITH_SLOPES = 16  # most variants in one call with derivatives
_WIDEST = 512  # most variants in one call
_ACCELERATED = 2048  # variants in every call on an accelerator, where idle lanes cost nothing
_PARTS, _FEWEST = 2, 20  # calls into which a batch is split for two cores; least variants of each
_COLUMNS = 32  # variants times parameters in one call with derivatives: enough to fill the processor's vector units
_ACCELERATED_COLUMNS = 256  # the same on an accelerator, where the time of a call hardly depends on its size
_ROUGH = 5e-4  # largest rms error of positions and lengths with the long steps of a search [m]
_ROUGH_SHARE = 0.1  # largest error of other channels, as a share of their range
_REMEMBERED = 4  # batches with derivatives that are cached
_STARTS = 96  # equilibria from which searches for equilibrium start
_COARSE_STEP, _FINE_STEP = 5e-3, 1e-2 / 6  # steps of searches and answers [s]: errors of 0.03 mm and 0.01 mm on the rig
HALVINGS = 2  # most halvings of the answer's step for the nominal motion; `fitting.finish` may halve it further
_EXACT = 1e-4  # largest rms error of positions and lengths by the answer's time steps [m]
_EXACT_SHARE = 0.02  # largest error of other channels, as a share of their range
_SEED = 20240418  # for the start equilibria: the same for every fit


class Prediction(NamedTuple):
    """Predictions for N variants; NaN where a variant could not be simulated."""

    values: Floats  # (N, n, c) the channels' columns: position 3 [m], orientation 4 (quaternion), forces 1 each [N]
    slopes: Floats | None  # (N, n, c, p) their derivatives with respect to the parameters, if requested
    usable: NDArray[np.bool_]  # (N,) whether the start equilibrium was found and all values are finite


class StepError(NamedTuple):
    """Error of one channel due to the length of the time steps."""

    rms: float  # over the frames [m], [rad] or [N]
    large: bool  # whether it exceeds the limit for an answer


@dataclass(eq=False)
class Evaluator:
    """Simulates the channels of one scene for many parameter vectors. Raises InputError if a device does not exist.

    The program computes all of `computed`, and `channels` are selected from its output: evaluators that differ only in
    `channels` share one compiled program.
    """

    scene: Scene  # the nominal scene
    parameters: Parameters  # the free parameters
    channels: tuple[str, ...]  # channels to predict, in this order
    chunk: int = CHUNK  # variants in one call; larger batches are split, and the last part is padded
    pull_chunk: int = 8  # the same for gradients by reverse mode
    computed: tuple[str, ...] | None = None  # channels that the program computes, including `channels`; default: these
    devices: Devices = "all"  # over which each call's variants are distributed, as in `pftwin.simulate_batch`

    def __post_init__(self) -> None:
        found = chosen_devices(self.devices)
        self._count, self._threads = len(found), feeding_threads(self.devices)
        self._accelerated = found[0].platform != "cpu"
        warn_of_accelerator(found[0].platform)
        mesh = programs.mesh_of(found)
        self._program = programs.FitProgram(self.parameters.places, self.computed or self.channels, mesh)
        self._unnamed_scene = self.scene.unnamed()
        self._readings = programs.reading_units(self.scene, self.channels)
        self._values_requested = True
        self._recent: list[tuple[Floats, int, Prediction]] = []

    def prepare(self, widest: int | None) -> None:
        """Sets the batch size from the largest request without derivatives; None if there will be no such request."""
        self._values_requested = widest is not None
        if self.in_turns:
            self.chunk = 1
        elif self._accelerated:
            self.chunk = _ACCELERATED
        elif widest is not None:
            threads = _PARTS if self._count == 1 and widest >= _PARTS * _FEWEST else 1
            self.chunk = -(-widest // max(-(-widest // (_WIDEST * self._count)), threads))

    def begin(self) -> Callable[[], None]:
        """Traces the program that a fit needs first; the returned function compiles it. Call `prepare` before."""
        slopes = not self._values_requested
        width = self._call_width(self.slope_chunk if slopes else self.chunk)
        theta = jnp.asarray(np.zeros((width, len(self.parameters))), dtype=float)
        guesses = _selected(jax.tree.map(lambda a: np.asarray(a)[None], self.scene.start), np.zeros(width, int))
        program = programs.with_slopes if slopes else programs.predictions
        return program.begin(self._program, self._unnamed_scene, jnp.asarray(0), theta, guesses)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The nominal scene of every trial: here one."""
        return (self.scene,)

    def scenes_at(self, theta: Floats) -> tuple[Scene, ...]:
        """The scene of every trial at parameters (p,): here one."""
        return (self.parameters.apply(self.scene, theta),)

    @property
    def first(self) -> int:
        """Steps between two frames of the answer, before their error has been checked."""
        return substeps_for(self.scene.motion.frame_interval, _FINE_STEP)

    @cached_property
    def coarse(self) -> int:
        """Steps between two frames during a search: few, if the nominal motion is then accurate enough."""
        few = substeps_for(self.scene.motion.frame_interval, _COARSE_STEP)
        if few < self.fine:
            rough, good = (self.with_slopes(self.parameters.nominal[None], n) for n in (few, self.fine))
            if good.usable[0] and not (rough.usable[0] and self._agree(rough.values[0], good.values[0])):
                return self.fine
        return few

    def _agree(self, rough: Floats, good: Floats) -> bool:
        """Whether long steps are accurate enough for a search, judged by the position if compared, else by all."""
        judged = side_by_side(self.channels)
        for channel, columns in judged[:1] if self.channels[0] == POSITION else judged:
            a, b = rough[:, columns], good[:, columns]
            place = unit_of(channel, self._readings) == "m"
            off = np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))) if place else np.abs(a - b).max()
            if off > (_ROUGH if place else _ROUGH_SHARE * np.ptp(b, axis=0).max()):
                return False
        return True

    @cached_property
    def fine(self) -> int:
        """Steps between two frames of the final answer, halved while the nominal motion's error is too large."""
        return self.short_enough()

    def short_enough(self, *, slopes: bool = True) -> int:
        """Steps between two frames that are accurate enough for the nominal motion; `slopes` as in `step_errors`."""
        steps = self.first
        for _ in range(HALVINGS):
            errors = self.step_errors(self.parameters.nominal, steps, slopes=slopes)
            if not any(e.large for e in errors.values()):
                break
            steps *= 2
        return steps

    def step_errors(self, theta: Floats, substeps: int, *, slopes: bool = True) -> dict[str, StepError]:
        """Error of each channel due to the time steps at parameters (p,), from a run with half the step (first order).

        Empty if either run fails. `slopes`: use the program with derivatives, where that one is compiled anyway.
        """
        run = self.with_slopes if slopes else self.values
        long, short = (run(theta[None], n) for n in (substeps, 2 * substeps))
        if not (long.usable[0] and short.usable[0]):
            return {}
        found = {}
        for channel, columns in side_by_side(self.channels):
            a, b = (run.values[0, :, columns] for run in (long, short))
            rms = 2 * float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))
            if channel == ORIENTATION:
                rms *= 2  # an angle is twice the change of the quaternion
            place = unit_of(channel, self._readings) == "m"
            most = _EXACT if place else _EXACT_SHARE * float(np.ptp(b, axis=0).max())
            found[channel] = StepError(rms, rms > most)
        return found

    def values(self, theta: Floats, substeps: int) -> Prediction:
        """Predictions for (N, p) parameters."""
        return self._in_chunks(theta, substeps, self.chunk, slopes=False)

    def with_slopes(self, theta: Floats, substeps: int) -> Prediction:
        """Predictions and their derivatives for (N, p) parameters; the last few batches are cached."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        for before, steps, prediction in self._recent:
            if steps == substeps and len(rows := _matching_rows(theta, before)) == len(theta):
                assert prediction.slopes is not None
                return Prediction(prediction.values[rows], prediction.slopes[rows], prediction.usable[rows])
        prediction = self._in_chunks(theta, substeps, self.slope_chunk, slopes=True)
        self._recent = [(theta.copy(), substeps, prediction), *self._recent[: _REMEMBERED - 1]]
        return prediction

    def gradients(self, theta: Floats, substeps: int, pulls: Floats) -> Floats:
        """Gradients (N, p) of a function of the predictions by reverse mode, at (N, p) parameters; `pulls` (N, n, c)
        are the function's derivatives with respect to the predictions."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        program = self._program._replace(channels=self.channels)
        width, parts = self._call_width(1 if self.in_turns else self.pull_chunk), []
        for i in range(0, len(theta), width):
            part = slice(i, i + width)
            full, cotangents = (_filled(a[part], width) for a in (theta, pulls))
            numbers = jnp.asarray(full, dtype=float), self.guesses(full), jnp.asarray(cotangents, dtype=float)
            found = programs.loss_gradients(program, self._unnamed_scene, substeps, *numbers)
            parts.append(np.asarray(found)[: len(theta[part])])
        return np.concatenate(parts)

    @property
    def in_turns(self) -> bool:
        """Whether a call computes its variants one after another, so that batching them saves nothing."""
        return not self._accelerated and any(e.in_turns for e in self.scene.effects)

    @property
    def slope_chunk(self) -> int:
        """Variants in one call with derivatives."""
        if self.in_turns:
            return 1
        columns = _ACCELERATED_COLUMNS if self._accelerated else _COLUMNS
        return max(1, min(_WITH_SLOPES, columns // len(self.parameters)))

    def _call_width(self, chunk: int) -> int:
        """Variants in a call, rounded up to the same number on every device."""
        return -(-chunk // self._count) * self._count

    def _in_chunks(self, theta: Floats, substeps: int, chunk: int, *, slopes: bool) -> Prediction:
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        self._start_equilibria  # noqa: B018 (computed before the threads need it)
        width = self._call_width(chunk)

        def one(part: Floats) -> list[Any]:
            full = _filled(part, width)
            out = self._run(full, self.guesses(full), substeps, slopes)
            return [None if a is None else a[: len(part)] for a in out[:3]]

        parts = self._in_threads(one, [theta[i : i + width] for i in range(0, len(theta), width)])
        values, slope, found = (None if a[0] is None else np.concatenate(a) for a in zip(*parts, strict=True))
        assert values is not None
        assert found is not None
        if self.computed is not None:
            columns = columns_of(self.channels, self.computed)
            values = values[..., columns]
            slope = None if slope is None else slope[..., columns, :]
        usable = found & np.isfinite(values).all(axis=(1, 2))
        if slope is not None:
            usable &= np.isfinite(slope).all(axis=(1, 2, 3))
        return Prediction(values, slope, usable)

    def _run(self, theta: NDArray, guesses: Pose, substeps: int, slopes: bool) -> tuple[Any, Any, Any, Any]:
        """Values (N, n, c), slopes (N, n, c, p) or None, whether in equilibrium at the start (N,), starting poses."""
        args = (self._program, self._unnamed_scene, jnp.asarray(substeps), jnp.asarray(theta, dtype=float), guesses)
        if not slopes:
            values, poses, found = programs.predictions(*args)
            return np.asarray(values), None, np.asarray(found), poses
        (values, poses, found), columns = programs.with_slopes(*args)
        return np.asarray(values), np.moveaxis(np.asarray(columns), 0, -1), np.asarray(found), poses

    def guesses(self, theta: Floats) -> Pose:
        """Poses (N,) from which searches for equilibrium start: the nearest of the precomputed equilibria."""
        where, poses = self._start_equilibria
        distance = np.sum((self.parameters.share(theta)[:, None] - where[None]) ** 2, axis=-1)
        return _selected(poses, np.argmin(distance, axis=1))

    @cached_property
    def _start_equilibria(self) -> tuple[Floats, Pose]:
        """Equilibria throughout the bounds: parameters as shares of their range (m, p), poses (m,); nominal first."""
        slopes = not self._values_requested
        width = self._call_width(self.slope_chunk if slopes else self.chunk)
        start = jax.tree.map(lambda a: np.asarray(a)[None], self.scene.start)
        members = self.parameters.scattered(_STARTS, np.random.default_rng(_SEED))
        members = np.concatenate([self.parameters.nominal[None], members])
        parts = [_filled(members[i : i + width], width) for i in range(0, len(members), width)]

        def settled(part: Floats, guess: Pose) -> tuple[NDArray[np.bool_], Pose]:
            _, _, found, pose = self._run(part, _selected(guess, np.zeros(width, int)), 0, slopes)
            return found, jax.tree.map(np.asarray, pose)

        first, poses = settled(parts[0], start)
        # If the nominal equilibrium was not found, the scene's start pose replaces it.
        guess = jax.tree.map(lambda a: a[:1], poses) if first[0] else start
        others = self._in_threads(lambda part: settled(part, guess), parts[1:])
        where, found = [self.parameters.share(parts[0][:1])], [guess]
        for part, (there, pose) in zip(parts, [(first, poses), *others], strict=True):
            keep = np.flatnonzero(there)
            where.append(self.parameters.share(part[keep]))
            found.append(jax.tree.map(lambda a, keep=keep: a[keep], pose))
        return np.concatenate(where), jax.tree.map(lambda *a: np.concatenate(a), *found)

    def _in_threads(self, run: Callable[[Floats], T], pieces: Sequence[Floats]) -> list[T]:
        """Results for all pieces, in threads: XLA runs a loop of small operations on one core only."""
        if len(pieces) < 2 or self._threads == 1:
            return list(map(run, pieces))
        with ThreadPoolExecutor(min(len(pieces), self._threads)) as pool:
            return list(pool.map(run, pieces))


def _filled(rows: Floats, width: int) -> Floats:
    """Rows padded with copies of the first, (width, ...)."""
    return np.concatenate([rows, np.repeat(rows[:1], width - len(rows), axis=0)])


def _selected(poses: Pose, which: NDArray[np.intp]) -> Pose:
    return jax.tree.map(lambda a: jnp.asarray(a[which], dtype=float), poses)


def _matching_rows(theta: Floats, among: Floats) -> list[int]:
    """Indices of the rows of `theta` among cached parameters; shorter than `theta` if some are missing."""
    at = {row.tobytes(): i for i, row in enumerate(among)}
    return [at[row.tobytes()] for row in theta if row.tobytes() in at]
