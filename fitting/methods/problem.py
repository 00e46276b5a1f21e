"""What every method of fitting sees: a function of the free parameters, evaluated in batches."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from numpy.typing import NDArray

from fitting.evaluation import Evaluator, Prediction
from fitting.objective import Objective
from fitting.parameters import Parameters
from pftwin.dynamics.batch.devices import Devices
from pftwin.model.scene import Scene

Floats = NDArray[np.float64]


class Request(NamedTuple):
    """What a method wants to know."""

    theta: Floats  # (N, p)
    substeps: int
    want: Literal["value", "gradient", "normal"] = "value"  # alone, with its gradient, or with the Hessian as well


class ProblemAnswer(NamedTuple):
    """The objective, infinite where the prediction is not usable; gradient and Gauss-Newton Hessian as asked for."""

    value: Floats  # (N,)
    gradient: Floats | None = None  # (N, p)
    hessian: Floats | None = None  # (N, p, p)


@dataclass(eq=False)
class Problem:
    """A scene, what is free in it, and what it is compared with."""

    scene: Scene
    parameters: Parameters
    objective: Objective
    evaluator: Evaluator

    @staticmethod
    def of(
        scene: Scene,
        parameters: Parameters,
        objective: Objective,
        computed: tuple[str, ...] | None = None,
        devices: Devices = "all",
    ) -> Problem:
        """With its own evaluator, which computes these channels on these devices."""
        evaluator = Evaluator(scene, parameters, objective.channels, computed=computed, devices=devices)
        return Problem(scene, parameters, objective, evaluator)

    def answer(self, request: Request) -> ProblemAnswer:
        """The objective, what is known beforehand included."""
        theta = np.atleast_2d(request.theta)
        prior, pull, precision = self.parameters.prior_terms(theta)
        if request.want == "value":
            value = self.objective.value(self.evaluator.values(theta, request.substeps))
            return ProblemAnswer(value + prior)
        if request.want == "gradient":
            prediction, gradient = self.evaluator.with_pull(theta, request.substeps, self.objective.pull)
            value = self.objective.value(prediction)
            known = np.isfinite(value) & np.isfinite(gradient).all(axis=1)
            return ProblemAnswer(np.where(known, value + prior, np.inf), np.where(known[:, None], gradient + pull, 0.0))
        value, gradient, hessian = self.objective.normal(self.evaluator.with_slopes(theta, request.substeps))
        return ProblemAnswer(value + prior, gradient + pull, hessian + np.diag(precision))

    def prediction(self, theta: Floats, substeps: int) -> Prediction:
        """With derivatives, at one point (p,)."""
        return self.evaluator.with_slopes(theta[None], substeps)

    def fingerprint(self, *settings: Any) -> str:
        """A hash of all that decides the course of a fit: scene, parameters, measurements, and these settings."""
        total = hashlib.sha256()
        arrays, fixed = eqx.partition(self.scene.unnamed(), eqx.is_array)
        texts = [jax.tree.structure(arrays), jax.tree.leaves(fixed), jax.tree.structure(fixed)]
        o = self.objective
        texts += [self.parameters, o.kind, o.channels, o.noise, o.loss, settings, self.evaluator.computed]
        total.update(repr(texts).encode())
        for array in (*jax.tree.leaves(arrays), o.measured, o.present):
            total.update(np.ascontiguousarray(array).tobytes())
        return total.hexdigest()
