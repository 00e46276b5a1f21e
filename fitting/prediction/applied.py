"""Estimated values put into scenes, by a function that programs of other estimates of the same parameters share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pftwin.model.scene import Scene


@dataclass(frozen=True)
class Applied:
    """`Estimate.apply`. Two of them are equal if they set the same parameters: a program takes the values (theta) as
    arrays and holds this by its equality, while methods of two estimates are never equal.
    """

    names: tuple[str, ...]
    values: Any = field(compare=False)  # (p,)

    def __call__(self, scene: Scene, theta: Any = None) -> Scene:
        """The scene with the values, or with others (p,). Pure in theta.

        Raises:
            InputError: it has no such parameters.
        """
        import jax.numpy as jnp

        from fitting.parameters import applied
        from pftwin.model.scene_parameters import find

        places = tuple(find(scene, name)[0] for name in self.names)
        return applied(places, scene, jnp.asarray(self.values, dtype=float) if theta is None else theta)
