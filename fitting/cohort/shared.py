"""A patient's estimate, such that patients with the same parameters share one program for their predictions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    import numpy as np

    from fitting.estimate import Estimate
    from pftwin.scene import Scene


@dataclass(frozen=True)
class _Apply:
    """As `Estimate.apply`. Two of them are equal if they set the same parameters: a program takes the values (theta) as
    arrays, and holds this by its equality, while methods of two estimates are never equal.
    """

    names: tuple[str, ...]
    values: Any = field(compare=False)

    def __call__(self, scene: Scene, theta: Any = None) -> Scene:
        import jax.numpy as jnp

        from fitting.parameters import applied
        from fitting.places import find

        places = tuple(find(scene, name)[0] for name in self.names)
        return applied(places, scene, jnp.asarray(self.values, dtype=float) if theta is None else theta)


class Shared:
    """What `fitting.predict` needs of an estimate."""

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate
        self.names, self.units, self.values = estimate.names, estimate.units, estimate.values
        self.synthetic, self.source = estimate.synthetic, estimate.source
        self.apply = _Apply(estimate.names, estimate.values)

    def samples(self, count: int, seed: int = 0) -> NDArray[np.float64]:
        """As `Estimate.samples`."""
        return self._estimate.samples(count, seed)
