"""Linear models of two channels of unlike size, whose estimates, covariances and information have closed forms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from fitting.evaluation import Prediction
from fitting.methods.problem import Method, Problem, State
from fitting.objective import Objective
from fitting.parameters import Parameter, Parameters

CHANNELS = ("position", "contact")
NOISE = {"position": 0.02, "contact": 0.5}
NOMINAL = np.array([1.2, -30.0, 0.4])  # unlike sizes and one negative: a slip of scale or of a sign shows


def parameters(priors: tuple[Any, ...] = (None, None, None), half_width: float = 1e3) -> Parameters:
    place: Any = None
    return Parameters(
        tuple(
            Parameter(name, place, value, value - half_width, value + half_width, known)
            for name, value, known in zip("abc", NOMINAL, priors, strict=True)
        )
    )


def objective(measured: np.ndarray, noise: dict[str, float] | None = NOISE, **more: Any) -> Objective:
    """A position (three columns) and a force (one); NaN where nothing was measured."""
    fields: dict[str, Any] = {
        "kind": "likelihood",
        "channels": CHANNELS,
        "measured": measured,
        "present": np.isfinite(measured),
        "groups": CHANNELS,
        "group_of": np.array([0, 0, 0, 1]),
        "noise": noise,
        "loss": "linear",
        "synthetic": True,
        "source": "a formula",
    }
    return Objective(**{**fields, **more})


def design(frames: int = 40, seed: int = 0) -> np.ndarray:
    """(frames, 4, 3): what every column gains by every parameter."""
    random = np.random.default_rng(seed)
    return random.normal(size=(frames, 4, 3)) * np.array([1.0, 0.05, 2.0]) * np.array([[0.1], [0.2], [0.15], [3.0]])


def problem(
    slopes: np.ndarray,
    measured: np.ndarray,
    known: Parameters,
    noise: dict[str, float] | None = NOISE,
    loss: str = "linear",
) -> Problem:
    """Predictions `slopes @ theta`."""

    def with_slopes(theta: np.ndarray, substeps: int) -> Prediction:
        values = np.einsum("tmp,np->ntm", slopes, theta)
        return Prediction(values, np.broadcast_to(slopes, (len(theta), *slopes.shape)), np.ones(len(theta), bool))

    def gradients(theta: np.ndarray, substeps: int, pulls: np.ndarray) -> np.ndarray:
        """As reverse mode does: derivatives of the predictions times the pulls."""
        return np.einsum("ntm,tmp->np", pulls, slopes)

    evaluator: Any = SimpleNamespace(
        with_slopes=with_slopes,
        values=with_slopes,
        gradients=gradients,
        first=1,
        fine=1,
        coarse=1,
        slope_chunk=1,
        in_turns=False,
        scenes=(SimpleNamespace(motion=SimpleNamespace(frame_interval=0.01)),),
        step_errors=lambda theta, substeps, slopes: {},
    )
    scene: Any = None
    return Problem(scene, known, objective(measured, noise, loss=loss), evaluator)


def scaled(slopes: np.ndarray, present: np.ndarray | None = None) -> np.ndarray:
    """The design in units of the noise, a row for every number that was measured."""
    sigma = np.array([0.02, 0.02, 0.02, 0.5])
    there = np.ones(slopes.shape[:2], bool) if present is None else present
    return (slopes / sigma[:, None])[there]


def run(search: Method) -> State:
    """A search to its end, with what `fit_tendons` notes on the way."""
    state = {**search.begin(), "iteration": 0, "evaluations": 0, "history": [], "interrupted": False}
    while state["stopped"] is None:
        request = search.ask(state)
        search.tell(state, request, search.problem.answer(request))
        state["iteration"] += 1
        state["evaluations"] += len(request.theta)
        state["history"].append({key: state[key] for key in ("iteration", "evaluations")})
    return state
