"""Springs that stiffen as they are stretched, and the straight lines nearest to them, which a twin has."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.model.effects.line_elements import TOE
from pftwin.model.effects.tendon import DampedLine, SpringForce
from pftwin.model.scene import Scene

Floats = NDArray[np.float64]

_TAUT = 2.0  # least distance of the slack length from the lengths that occur, in their deviations


class StiffeningSpring(NamedTuple):
    """F = K s (1 + e s / (L0 / 4))."""

    stiffness: Scalar  # K [N/m]
    more: Scalar  # 4 e / L0 [1/m]

    def at(self, stretch: Scalar) -> SpringForce:
        """At a stretch [m]."""
        k, m, s = self.stiffness, self.more, stretch
        return SpringForce(k * s * (1 + m * s), k * (1 + 2 * m * s), k * s * s * (0.5 + m * s / 3))


class StiffeningTendon(DampedLine):
    """A tendon that is stiffer the more it is stretched."""

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True))  # K, where it begins to pull
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True))  # L0
    damping: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    stiffening: Scalar = eqx.field(metadata=quantity("", at_least=0))  # e, when stretched by a quarter of its length
    body: str = eqx.field(static=True)

    @property
    def law(self) -> StiffeningSpring:
        """Its spring's."""
        return StiffeningSpring(self.stiffness, 4 * self.stiffening / self.slack_length)


def linear_tendons(scene: Scene) -> tuple[str, ...]:
    """Names of the single tendons whose springs are linear: those that offer a toe region."""
    lines = [e for e in scene.effects if any(change.label == TOE for change in e.elaborations())]
    return tuple(e.name for e in lines if (line := e.line_element()) is not None and line.count is None)


def stiffened(scene: Scene, shares: dict[str, Any]) -> Scene:
    """The scene with tendons that stiffen in the place of its linear ones of these names (`linear_tendons`), each by
    its share when stretched by a quarter of its length."""
    for name, share in shares.items():
        e: Any = scene.effect(name)
        numbers = e.stiffness, e.slack_length, e.damping, e.insertion, e.origin, jnp.asarray(share, float)
        scene = scene.with_effect(StiffeningTendon(*numbers, e.body, name=name))
    return scene


class Working(NamedTuple):
    """The lengths at which a tendon works."""

    mean: float  # [m]
    variance: float  # [m^2]
    skew: float  # the third central moment over the variance [m]

    @staticmethod
    def of(lengths: Floats) -> Working:
        """Of lengths (n,) over the frames."""
        off = lengths - lengths.mean()
        variance = float(np.mean(off**2))
        return Working(float(lengths.mean()), variance, float(np.mean(off**3)) / max(variance, 1e-300))

    def bent(self, stiffness: Floats, slack_length: Floats, share: Floats) -> tuple[Floats, Floats, Floats]:
        """Springs that stiffen by shares (N,), to whose forces at these lengths the lines with these stiffnesses and
        slack lengths are nearest, by least squares: their own stiffnesses, slack lengths and shares.

        With m = 4 e / L, D from L to the mean length, v the lengths' variance, c their skew, a slack length lies at

            d = 2 (D (1 + m c) - m v) / (1 - 2 m D + sqrt((1 - 2 m D)^2 + 4 m (D (1 + m c) - m v)))

        below the mean, and the stiffness is that of the line over 1 + m (2 d + c). A tendon that is slack at some of
        the lengths stays straight.
        """
        reach = self.mean - slack_length
        m = np.where(reach > _TAUT * np.sqrt(self.variance), 4 * share / slack_length, 0.0)
        b, a = 1 - 2 * m * reach, reach * (1 + m * self.skew) - m * self.variance
        d = 2 * a / (b + np.sqrt(np.maximum(b * b + 4 * m * a, 0.0)))
        own = self.mean - d
        return stiffness / (1 + m * (2 * d + self.skew)), own, m * own / 4
