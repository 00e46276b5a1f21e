"""Simulates variants in chunks: a compiled function of treatment amounts, parameters and start poses.

Memory does not grow with the number of variants: a chunk's trajectories are freed once its outcomes are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.prediction.outcomes import Course, CourseFrame, Groove, course_of, measure
from fitting.treatments import Treatment
from pftwin.base.arrays import Floats
from pftwin.base.spatial import Pose
from pftwin.dynamics.batch.batched import good_sizes
from pftwin.dynamics.batch.devices import Devices, chosen_devices, feeding_threads
from pftwin.dynamics.batch.member import frames_with_flags, run_with_error, scene_is_valid
from pftwin.dynamics.batch.retry import SMALLER
from pftwin.dynamics.batch.sharding import Chunk, Sharding
from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import observe_on_the_way
from pftwin.dynamics.status import FLAGS, Status
from pftwin.model.scene import Scene

_NEAR = 48  # equilibria found from the scene's own start pose; other searches start from the nearest of these
_INTEGRATOR = BDF2()
_FEWEST = 16  # smallest chunk: smaller ones take as long


class Recipe(NamedTuple):
    """How a variant's scene is made from its numbers, and simulated. Static fields are hashable, others are arrays."""

    scene: Scene
    treatment: Treatment
    fitted: Callable[[Scene, Any], Scene] | None  # sets parameters in the scene
    groove: Groove
    substeps: Array  # () traced, so that one program serves all step lengths
    threshold: float
    trajectories: bool

    def made(self, amounts: Array, theta: Array) -> Scene:
        """The scene of one variant: parameters first, then the treatment."""
        scene = self.scene if self.fitted is None else self.fitted(self.scene, theta)
        return self.treatment.with_values(list(amounts))(scene)

    def observed(self, scene: Scene, substeps: Array) -> tuple[CourseFrame, Array]:
        """The variant's observations (frames,) and their status."""
        options: Any = {"substeps": substeps, "integrator": _INTEGRATOR}
        seen, status, _ = observe_on_the_way(scene, lambda frame: CourseFrame.of(scene, frame), **options)
        return seen, status

    def course(self, scene: Scene) -> Course:
        """The variant's motion, without an estimate of its error."""
        return course_of(scene, *self.observed(scene, self.substeps), self.groove)


class Members(NamedTuple):
    """Results of variants, (n, ...) arrays on the host."""

    outcomes: dict[str, Floats]
    flags: NDArray[np.int64]  # (n, flags) frames with each of `FLAGS`
    sensible: NDArray[np.bool_]  # (n,) whether the scene is valid: all its values are possible
    courses: dict[str, Floats]  # (n, frames, ...), if trajectories are requested


def _member_outcomes(recipe: Recipe, a: Array, theta: Array, start: Pose) -> Any:
    """Outcomes of one variant; its motion is flagged if the estimated error of its steps is too large."""
    scene = eqx.tree_at(lambda s: s.start, recipe.made(a, theta), start)
    (seen, status), error = run_with_error(
        lambda n: recipe.observed(scene, n), lambda found: found[0].compared(), recipe.substeps, _INTEGRATOR.order
    )
    at = course_of(scene, seen, status | error.flags.astype(status.dtype), recipe.groove)
    flags = frames_with_flags(at.status)
    courses = {}
    if recipe.trajectories:
        courses = {
            "sphere_center": seen.center.array(),
            "groove_offset": at.offset,
            "patella_tilt": at.tilt,
            "force_medial": at.force[0],
            "force_lateral": at.force[1],
        }
    return measure(at, recipe.threshold), flags, scene_is_valid(scene), courses


@eqx.filter_jit
def _member_equilibria(recipe: Recipe, amounts: Array, thetas: Array) -> tuple[Pose, Array]:
    """Equilibria from the scene's own start: poses of the patella's frame, and whether the searches converged."""

    def one(a: Array, theta: Array) -> tuple[Pose, Array]:
        scene = recipe.made(a, theta)
        found = starting_equilibrium(scene)
        origin = found.pose.apply(-scene.patella.center_of_mass)
        return Pose(origin, found.pose.orientation), found.converged()

    return jax.vmap(one)(amounts, thetas)


def run(
    recipe: Recipe,
    amounts: Floats,
    thetas: Floats,
    chunk: int,
    devices: Devices = "all",
    progress: Callable[[int, int], None] | None = None,
    fewest: int = _FEWEST,
    care: bool = False,
) -> Members:
    """Simulates variants with amounts (n, k) and parameters (n, p). A failed variant does not stop the others.

    With `care`, variants whose estimated error is large are simulated again with a quarter of the step. A chunk holds
    up to `chunk` variants per device; a smaller study, and a repetition, is one smaller chunk, padded to `fewest`, as
    compiling another size takes longer than idle lanes.
    """
    recipe = recipe._replace(scene=recipe.scene.unnamed())
    chosen = chosen_devices(devices)
    size = min(chunk, max(fewest, 1 << (len(amounts) - 1).bit_length()))  # powers of two, so that programs are reused

    def simulated(amounts: Floats, thetas: Floats, starts: Pose | None, progress: Any, recipe: Recipe) -> Members:
        n = len(amounts)
        if starts is None:
            starts = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a), (n,)), recipe.scene.start)
        pieces, piece = good_sizes(size, chosen[0].platform)
        sharding = Sharding(chosen, piece, pieces * piece * len(chosen))
        shared, rows = sharding.shared(recipe), (np.asarray(amounts, float), np.asarray(thetas, float), starts)

        def computed(some: Chunk) -> Members:
            return Members(
                *sharding.taken(sharding.run(_member_outcomes, shared, some, sharding.placed(rows, some)), some)
            )

        return sharding.over(computed, n, feeding_threads(devices), progress)

    starts = _starts(recipe, amounts, thetas)
    found = simulated(amounts, thetas, starts, progress, recipe)

    def again(which: NDArray[np.bool_], recipe: Recipe) -> None:
        if which.any():
            chosen = None if starts is None else jax.tree.map(lambda a: a[which], starts)
            better = simulated(amounts[which], thetas[which], chosen, None, recipe)
            jax.tree.map(lambda old, new: old.__setitem__(which, new), found, better)

    if starts is not None:
        lost = _flagged(found, Status.START_NOT_IN_EQUILIBRIUM)
        starts = jax.tree.map(lambda a, own: np.where(lost, np.asarray(own), a), starts, recipe.scene.start)
        again(lost, recipe)
    if care:
        again(_flagged(found, Status.INACCURATE), recipe._replace(substeps=SMALLER * recipe.substeps))
    return found


def _flagged(found: Members, flag: Status) -> NDArray[np.bool_]:
    return found.flags[:, FLAGS.index(flag)] > 0


def _starts(recipe: Recipe, amounts: Floats, thetas: Floats) -> Pose | None:
    """For each variant the pose from which to search for equilibrium, (n,); None: the scene's own."""
    if len(amounts) <= _NEAR:
        return None
    points = np.concatenate([amounts, thetas], axis=1)
    spread = np.ptp(points, axis=0)
    points = points[:, spread > 0] / spread[spread > 0]
    chosen, nearest = _spread_out(points, _NEAR)
    padded = np.resize(chosen, _NEAR)
    poses, good = jax.tree.map(
        np.asarray, _member_equilibria(recipe, jnp.asarray(amounts[padded]), jnp.asarray(thetas[padded]))
    )
    if not good.any():
        return None
    usable = good[: len(chosen)]
    if not usable.all():  # no variant starts from a search that failed
        distance = np.stack([np.sum((points - points[i]) ** 2, axis=1) for i in chosen[usable]])
        nearest = np.flatnonzero(usable)[np.argmin(distance, axis=0)]
    return jax.tree.map(lambda a: a[nearest], poses)


def _spread_out(points: Floats, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Up to `count` points far apart by farthest-first traversal (Gonzalez 1985), and the nearest of them to each."""
    chosen, nearest = [0], np.zeros(len(points), dtype=np.int64)
    distance = np.sum((points - points[0]) ** 2, axis=1)
    while len(chosen) < min(count, len(points)) and distance.max(initial=0.0) > 0:
        far = int(np.argmax(distance))
        closer = np.sum((points - points[far]) ** 2, axis=1)
        nearest[closer < distance] = len(chosen)
        distance = np.minimum(distance, closer)
        chosen.append(far)
    return np.array(chosen), nearest
