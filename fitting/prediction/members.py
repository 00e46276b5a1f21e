"""Simulates variants in chunks: compiled functions of treatment amounts, parameters and start poses.

Memory does not grow with the number of variants: a chunk's trajectories are freed once its outcomes are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from fitting.prediction.outcomes import Course, CourseFrame, Groove, course_of, measure
from fitting.treatments import Treatment
from pftwin.base.arrays import Floats
from pftwin.base.spatial import Pose
from pftwin.dynamics.batch.batched import Chunk, Sharding, good_sizes
from pftwin.dynamics.batch.devices import Devices, chosen_devices, feeding_threads
from pftwin.dynamics.batch.member import frames_with_flags, run_with_error, scene_is_valid
from pftwin.dynamics.batch.plan import SMALLER
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.equilibrium_report import Start, start_offset
from pftwin.dynamics.frame_states import starting_equilibrium
from pftwin.dynamics.integrators import BDF2
from pftwin.dynamics.observe import observe_during_run
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

    def observed(self, scene: Scene, substeps: Array, start: Solution | None = None) -> tuple[CourseFrame, Array]:
        """The variant's observations (frames,) and their status; `start`: its equilibrium, by default solved for."""
        options: Any = {"substeps": substeps, "integrator": _INTEGRATOR, "start": start}
        frames, status, _ = observe_during_run(scene, lambda frame: CourseFrame.of(scene, frame), **options)
        return frames, status

    def course(self, scene: Scene) -> Course:
        """The variant's motion, without an estimate of its error."""
        return course_of(scene, *self.observed(scene, self.substeps), self.groove)


class Members(NamedTuple):
    """Results of variants, (n, ...) arrays on the host."""

    outcomes: dict[str, Floats]
    flags: NDArray[np.int64]  # (n, flags) frames with each of `FLAGS`
    sensible: NDArray[np.bool_]  # (n,) whether the scene is valid: all its values are possible
    courses: dict[str, Floats]  # (n, frames, ...), if trajectories are requested


class _Settled(NamedTuple):
    """A variant's equilibrium."""

    found: Solution
    pose: Pose  # of the patella's frame
    start: Start


def _member_start(recipe: Recipe, a: Array, theta: Array, start: Pose) -> _Settled:
    """Equilibrium of one variant, by descent from a pose of the patella's frame."""
    scene = recipe.made(a, theta)
    found = starting_equilibrium(scene, start)
    pose = Pose(found.pose.apply(-scene.patella.center_of_mass), found.pose.orientation)
    return _Settled(found, pose, Start(found.converged(), *start_offset(scene, found)))


def _member_outcomes(recipe: Recipe, a: Array, theta: Array, start: Solution) -> Any:
    """Outcomes of one variant; its motion is flagged if the estimated error of its steps is too large."""
    scene = recipe.made(a, theta)
    (frames, status), error = run_with_error(
        lambda n: recipe.observed(scene, n, start),
        lambda found: found[0].compared(),
        recipe.substeps,
        _INTEGRATOR.order,
    )
    at = course_of(scene, frames, status | error.flags.astype(status.dtype), recipe.groove)
    flags = frames_with_flags(at.status)
    courses = {}
    if recipe.trajectories:
        courses = {
            "sphere_center": frames.center.array(),
            "groove_offset": at.offset,
            "patella_tilt": at.tilt,
            "force_medial": at.force[0],
            "force_lateral": at.force[1],
        }
    return measure(at, recipe.threshold), flags, scene_is_valid(scene), courses


class MemberPrograms:
    """Programs for all variants of a recipe, and the devices that run them.

    A chunk holds up to `chunk` variants per device. Fewer variants (`count`) and repetitions are one chunk of at least
    `fewest`, filled to a power of two: idle lanes cost less than compiling another size.
    """

    def __init__(self, recipe: Recipe, count: int, chunk: int, devices: Devices = "all", fewest: int = _FEWEST) -> None:
        self.recipe = recipe._replace(scene=recipe.scene.unnamed())
        chosen = chosen_devices(devices)
        size = min(chunk, max(fewest, 1 << (count - 1).bit_length()))  # powers of two, so that programs are reused
        pieces, piece = good_sizes(size, chosen[0].platform)
        self._sharding = Sharding(chosen, piece, pieces * piece * len(chosen))
        self._threads = feeding_threads(devices)

    def settled(self, amounts: Floats, thetas: Floats, starts: Pose | None = None) -> tuple[Pose, Start]:
        """Equilibria, searched for from `starts` (n,): poses of the patella's frame (n,), and what is judged of them.

        Without `starts` searches begin at the scene's own start.
        """
        shared = self._sharding.shared(self.recipe)

        def computed(some: Chunk) -> tuple[Pose, Start]:
            rows = self._sharding.placed(self._rows(amounts, thetas, starts), some)
            settled = self._sharding.run(_member_start, shared, some, rows)
            return self._sharding.taken((settled.pose, settled.start), some)

        return self._sharding.over(computed, len(amounts), self._threads)

    def untreated(self, thetas: Floats, starts: Pose | None = None) -> tuple[Pose, Start]:
        """Equilibria of the untreated scene with parameters (n, p)."""
        return self.settled(np.zeros((len(thetas), len(self.recipe.treatment.names))), thetas, starts)

    def simulated(
        self, amounts: Floats, thetas: Floats, starts: Pose | None, progress: Any = None, smaller: int = 1
    ) -> Members:
        """Motions, in steps smaller by a factor; the searches for equilibrium start from `starts` (n,)."""
        substeps = smaller * self.recipe.substeps
        shared = self._sharding.shared(self.recipe._replace(substeps=substeps))

        def computed(some: Chunk) -> Members:
            rows = self._sharding.placed(self._rows(amounts, thetas, starts), some)
            settled = self._sharding.run(_member_start, shared, some, rows)
            found = self._sharding.run(_member_outcomes, shared, some, (*rows[:2], settled.found))
            return Members(*self._sharding.taken(found, some))

        return self._sharding.over(computed, len(amounts), self._threads, progress)

    def _rows(self, amounts: Floats, thetas: Floats, starts: Pose | None) -> tuple[Floats, Floats, Pose]:
        own = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a), len(amounts)), self.recipe.scene.start)
        return np.asarray(amounts, float), np.asarray(thetas, float), own if starts is None else starts


def run(
    programs: MemberPrograms,
    amounts: Floats,
    thetas: Floats,
    progress: Callable[[int, int], None] | None = None,
    care: bool = False,
) -> Members:
    """Simulates variants with amounts (n, k) and parameters (n, p). A failed variant does not stop the others.

    With `care`, variants whose estimated error is large are simulated again with a quarter of the step.
    """
    starts = _starts(programs, amounts, thetas)
    found = programs.simulated(amounts, thetas, starts, progress)

    def rerun(which: NDArray[np.bool_], smaller: int = 1) -> None:
        if which.any():
            chosen = None if starts is None else jax.tree.map(lambda a: a[which], starts)
            better = programs.simulated(amounts[which], thetas[which], chosen, smaller=smaller)
            jax.tree.map(lambda old, new: old.__setitem__(which, new), found, better)

    if starts is not None:
        lost = _flagged(found, Status.START_NOT_IN_EQUILIBRIUM)
        starts = jax.tree.map(lambda a, own: np.where(lost, np.asarray(own), a), starts, programs.recipe.scene.start)
        rerun(lost)
    if care:
        rerun(_flagged(found, Status.INACCURATE), SMALLER)
    return found


def _flagged(found: Members, flag: Status) -> NDArray[np.bool_]:
    return found.flags[:, FLAGS.index(flag)] > 0


def _starts(programs: MemberPrograms, amounts: Floats, thetas: Floats) -> Pose | None:
    """For each variant the pose from which to search for equilibrium, (n,); None: the scene's own."""
    if len(amounts) <= _NEAR:
        return None
    points = np.concatenate([amounts, thetas], axis=1)
    ranges = np.ptp(points, axis=0)
    points = points[:, ranges > 0] / ranges[ranges > 0]
    chosen, nearest = _spread_out(points, _NEAR)
    poses, start = programs.settled(amounts[chosen], thetas[chosen])
    if not start.converged.any():
        return None
    if not start.converged.all():  # no variant starts from a search that failed
        usable = np.flatnonzero(start.converged)
        distance = np.stack([np.sum((points - points[i]) ** 2, axis=1) for i in chosen[usable]])
        nearest = usable[np.argmin(distance, axis=0)]
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
