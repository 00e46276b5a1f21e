"""Simulation of the whole motion for given slider values, with one compiled program per contact."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from fitting.cli.live.knobs import Knobs, neutral
from fitting.cli.live.motion import AS_SET, UNTREATED, Band, DrawnMotion, Floats, ShownMotion
from fitting.prediction.untreated import reasons_of, untrusted_start
from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.dynamics.simulate import prepare_relaxation, simulate
from pftwin.geometry.patch.closest import rectangle_of
from pftwin.model.scene import Scene
from pftwin.results.scene_geometry import MARGIN, continuation, geometry
from pftwin.results.viewer.shapes import MM, Shape

if TYPE_CHECKING:
    from xarray import Dataset

    from fitting.estimate import Estimate
    from pftwin.results.result import Result

DRAWS = 24  # draws from an estimate, for bands
FAR = 0.045  # width of the extrapolated surface around the fitted one [m]
HEIGHT = 0.02  # height over the chart of the corners that limit the extrapolation [m]
MOST_ANGLE = 2.8  # largest angle on a cylinder's chart, which closes at pi [rad]


@dataclass(frozen=True, eq=False)
class LiveModel:
    """A scene with one contact, compiled and ready to simulate."""

    contact: str
    knobs: Knobs
    still: Still
    before: ShownMotion  # untreated
    start: tuple[str, ...]  # reasons why the untreated scene's start makes all its motions INVALID


class Engine:
    """Simulates a treated scene with one of several contacts, with the parameters of an estimate if there is one.

    It is thread-safe. `run` computes the same motion as `pftwin.simulate` for the treated scene, and judges it as
    `fitting.predict` does: if the untreated scene starts INVALID, all its motions are.
    """

    def __init__(
        self, load: Callable[[str], Scene], contacts: tuple[str, ...], estimate: Estimate | None = None
    ) -> None:
        """Loads the scene of the first contact; `load` maps a contact's name to its scene and may raise InputError."""
        self._load, self.contacts, self.estimate = load, contacts, estimate
        self._models: dict[str, LiveModel] = {}
        self._tracing = threading.Lock()  # only one thread may trace at a time
        self._first = load(contacts[0])
        self._draws = () if estimate is None else estimate.samples(DRAWS)[:, : estimate.shared]
        self._untreated: dict[tuple[str, int], tuple[str, ...]] = {}  # why its start is INVALID, by contact and draw

    def ready(self, contact: str) -> bool:
        """Whether the model of this contact is compiled."""
        return contact in self._models

    def model(self, contact: str) -> LiveModel:
        """The model of a contact that is ready; KeyError for others."""
        return self._models[contact]

    def prepare(self, contact: str) -> LiveModel:
        """Compiles a contact's model, in seconds, unless it is ready; InputError if its scene cannot be simulated."""
        with self._tracing:
            if contact in self._models:
                return self._models[contact]
            if contact not in self.contacts:
                expected = f"one of: {', '.join(self.contacts)}"
                raise InputError(f"found {contact!r:.40}", where="contact", expected=expected)
            nominal = self._first if contact == self.contacts[0] else self._load(contact)
            knobs = Knobs.of(nominal, self.estimate)
            own, rest = nominal if self.estimate is None else self.estimate.apply(nominal), knobs.scene_with(neutral())
            still = Still(rest)
            # Compiles the simulation, and small programs for the drawing.
            start = reasons_of(own, _simulated(rest, UNTREATED, still, ()).result.equilibrium)
            prepare_relaxation(rest)
            before = _simulated(rest, UNTREATED, still.of(rest), start)
            before.refuse_if_lost()
            before.continued(DrawnMotion(before.recorded, 1.0).touched)
            return self._models.setdefault(contact, LiveModel(contact, knobs, still, before, start))

    def run(self, contact: str, values: Mapping[str, float]) -> ShownMotion:
        """Simulates the whole motion for these slider values, with a contact that is ready.

        Raises InputError for values that are not allowed, and for a motion without equilibrium or with lost frames.
        """
        model = self._models[contact]
        scene = model.knobs.scene_with(values)
        answer = _simulated(scene, AS_SET, model.still.of(scene), model.start)
        answer.refuse_if_lost(unlike=model.before)
        return answer

    def band(
        self, contact: str, values: Mapping[str, float], answer: ShownMotion, wanted: Callable[[], bool]
    ) -> Band | None:
        """Computes the band of a motion from `run`; None as soon as `wanted` returns False.

        Draws are simulated one by one with the compiled program, because a batch would take minutes to compile. Those
        whose own untreated scene starts INVALID are left out, as in `fitting.predict`.
        """
        model = self._models[contact]
        if model.start:
            return Band({}, "No bands: the untreated knee starts INVALID.")
        found: list[Result] = []
        for k, theta in enumerate(self._draws):
            if not wanted():
                return None
            if self._untreated_start(model, k):
                continue
            with contextlib.suppress(InputError):  # a draw with an impossible scene counts as lost
                found.append(simulate(model.knobs.scene_with(values, theta)))
        good = [result for result in found if result.verdict.valid]
        if not good:
            return Band({}, f"No bands: none of {len(self._draws)} draws from the estimate has a valid motion.")
        return Band.of(good, answer, len(self._draws))

    def _untreated_start(self, model: LiveModel, draw: int) -> tuple[str, ...]:
        """Reasons why a draw's untreated scene starts INVALID; found once for each contact."""
        key, knobs = (model.contact, draw), model.knobs
        if key not in self._untreated:
            theta = self._draws[draw]
            self._untreated[key] = untrusted_start(
                knobs.applied.fitted(knobs.scene, theta), knobs.scene_with(neutral(), theta)
            )
        return self._untreated[key]


def _simulated(scene: Scene, name: str, still: Still, start: tuple[str, ...]) -> ShownMotion:
    """Simulates with the default integrator and step, as all commands do."""
    began = time.perf_counter()
    result = simulate(scene)
    answer = ShownMotion.of(result, name, still.geometry(result), still.continued, start)
    return replace(answer, seconds=time.perf_counter() - began)


class Still:
    """Meshes and surfaces of a scene's drawing, reused while no slider changes the contact."""

    def __init__(self, scene: Scene) -> None:
        self._contact, self._bodies = scene.contact, geometry(scene)
        self._extrapolated = _extrapolated(scene)

    def of(self, scene: Scene) -> Still:
        """Returns this object if the scene has the same contact, else a new one for the scene."""
        return self if eqx.tree_equal(scene.contact, self._contact) else Still(scene)

    def geometry(self, result: Result) -> Dataset:
        """Geometry of a treated scene's result: the reused parts, and its own lines of force."""
        contact = result.scene.contact
        scene = result.scene if contact is None else result.scene.without(contact.name)
        lines = geometry(scene, poses=result.poses)
        return self._bodies.assign(lines.data_vars)

    def continued(self, points: Floats) -> Shape | None:
        """The extrapolated surface as far as contact points (k, 3) [m] reach; None if all are on the fitted rectangle.

        Missing points are NaN, so that the array's size, and with it the compiled program, stays the same.
        """
        if self._extrapolated is None or not len(points):
            return None
        chart, edges, shape, middles = self._extrapolated
        at = _along(chart, points)
        ends = [(np.nanmin(c), np.nanmax(c)) if np.isfinite(c).any() else (0.0, 0.0) for c in at]
        if all(low >= edge[0] and high <= edge[1] for (low, high), edge in zip(ends, edges, strict=True)):
            return None
        near = np.ones(len(shape.triangles), dtype=bool)
        for (low, high), edge, c in zip(ends, edges, middles, strict=True):
            near &= (c > min(low - MARGIN, edge[0])) & (c < max(high + MARGIN, edge[1]))
        return Shape(shape.vertices, shape.triangles[near])


def _along(chart: Any, points: Floats) -> tuple[Floats, Floats]:
    at = chart.coordinates(Vec3(*(jnp.asarray(c, float) for c in points.T)))
    return np.asarray(at.x, dtype=np.float64), np.asarray(at.y, dtype=np.float64)


def _extrapolated(scene: Scene) -> tuple[Any, list[tuple[float, float]], Shape, tuple[Floats, Floats]] | None:
    """The extrapolation of a fitted surface: its chart, the edges of the fitted rectangle [m], its shape at the largest
    extent, and chart coordinates of its triangles' centroids, (m,) each [m]; None without a smooth surface."""
    surface, contact = scene.surface, scene.contact
    if surface is None or contact is None or contact.femur_triangles() is not None:
        return None
    chart: Any = surface.chart
    edges = rectangle_of(surface)
    most = np.inf if chart.axis_radius is None else MOST_ANGLE * float(chart.axis_radius)  # as far as a cylinder's goes
    along = [max(edges[0][0] - FAR, -most), min(edges[0][1] + FAR, most)]
    corners = [chart.point(u, v, HEIGHT) for u in along for v in (edges[1][0] - FAR, edges[1][1] + FAR)]
    made = continuation(surface, np.array([[float(c.x), float(c.y), float(c.z)] for c in corners]))
    if made is None:
        return None
    shape = Shape((MM * made[0]).astype(np.float32), made[1].astype(np.uint32))
    return chart, edges, shape, _along(chart, made[0][made[1]].mean(axis=1))
