"""Several processes of one job, as `jax.distributed` joins them: who is there, and what they tell each other.

They meet in JAX's coordination service, which hears of every process by its heartbeats: a meeting waits for whoever
lives, however long, and for nobody else. Collectives (Gloo, NCCL) would do neither: one gives up after half an hour,
the other never. JAX has no public name for the service's client; this is the one place that uses it.
"""

from __future__ import annotations

import atexit
import itertools
from functools import cache
from typing import Any

import jax

from pftwin.base.errors import PftwinError

_SOON = 60_000  # [ms] for a text that was left before a meeting that is over
_calls = itertools.count()  # all processes make the same calls, in the same order


class Processes:
    """The processes that work on one batch; without `jax.distributed` this one alone."""

    def __init__(self) -> None:
        self.index, self.count = jax.process_index(), jax.process_count()
        self.alive = tuple(range(self.count))
        self._client = _client() if self.count > 1 else None
        if self.count > 1 and self.index == 0:
            _last_to_leave(self.count)
        self._call, self._steps = next(_calls) if self.count > 1 else 0, itertools.count()

    def gathered(self, text: str) -> dict[int, str]:
        """What each process that is still there has to say, by its index. Waits for all of them.

        From then on `alive` are those: all processes agree on it.
        """
        if self._client is None:
            return {self.index: text}
        place = f"pftwin/{self._call}/{next(self._steps)}"
        self._client.key_value_set(f"{place}/{self.index}", text)
        self.alive = tuple(sorted(self._client.get_live_nodes(list(self.alive))))
        return {i: self._client.blocking_key_value_get(f"{place}/{i}", _SOON) for i in self.alive}


def _client() -> Any:
    from jax._src import distributed

    client = distributed.global_state.client
    if not hasattr(client, "get_live_nodes"):
        raise PftwinError(f"JAX {jax.__version__} cannot say which processes live; try: a newer JAX")
    return client


@cache
def _last_to_leave(count: int) -> None:
    """The service lives in process 0, and who is still there when it goes is ended.

    JAX itself has processes leave together, but not where they may outlive each other (jax_enable_recoverability).
    """
    if getattr(jax.config, "jax_enable_recoverability", False):
        client = _client()
        atexit.register(lambda: client.get_live_nodes(list(range(count))))
