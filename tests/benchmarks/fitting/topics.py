"""What is measured, each topic in a process of its own: memory and compiled programs of one do not touch the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from tests.benchmarks.topics import in_a_process

if TYPE_CHECKING:
    from tests.benchmarks.row import Row

TOPICS = ("speed", "efficiency", "plant", "treatments", "methods")


def measure_topics(
    chosen: Sequence[str], seeds: int | None, quick: bool, say: Callable[[str], None]
) -> tuple[list[Row], dict[str, Any]]:
    """The rows of the chosen topics, and the machine they were measured on.

    Args:
        chosen: some of `TOPICS`.
        seeds: of efficiency and of methods; None: each topic's own number.
        quick: small sizes.
        say: is told what goes on.

    Raises:
        PftwinError: a measuring process failed.
    """
    import pftwin

    pftwin.configure()
    from pftwin.base import runtime as machine

    about, rows = machine.describe(), []
    for topic in chosen:
        say(f"measuring {topic} ...")
        rows += in_a_process({"topic": topic, "seeds": seeds, "quick": quick}, "tests.benchmarks.fitting.worker")
    return rows, about
