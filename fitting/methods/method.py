"""The shape of every method: it asks for evaluations and is told their answers; the host has the loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import jax

from fitting.methods.problem import Problem, ProblemAnswer, Request

State = dict[str, Any]  # arrays, numbers, texts and None: all that a method knows, so that a checkpoint holds it


class Method(ABC):
    """A search. All its randomness comes from the seed, and all it knows is in its state."""

    name: ClassVar[str]
    options: ClassVar[tuple[str, ...]]  # what a user may choose
    most_iterations: int
    starts: int  # points that it begins from
    widest: int | None = None  # the largest batch of plain values that it asks for; None: it asks for derivatives only

    def __init__(self, problem: Problem, seed: int) -> None:
        self.problem, self.seed = problem, seed

    @abstractmethod
    def begin(self) -> State:
        """The state before the first evaluation."""

    @abstractmethod
    def ask(self, state: State) -> Request:
        """What it wants evaluated next."""

    @abstractmethod
    def tell(self, state: State, request: Request, answer: ProblemAnswer) -> None:
        """Takes the answer in. Sets state["stopped"] to the reason when it ends."""

    @abstractmethod
    def settings(self) -> tuple[Any, ...]:
        """What decides its course besides problem and seed."""

    @abstractmethod
    def spread(self, state: State) -> float:
        """How far apart the objective's values are: a measure of progress."""

    @staticmethod
    def blank() -> State:
        """What every state has."""
        return {"best_value": float("inf"), "best_theta": None, "dropped": 0, "stopped": None}


@contextmanager
def lenient() -> Iterator[None]:
    """JAX's default rules for mixed types and ranks: libraries for optimisation need them."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield
