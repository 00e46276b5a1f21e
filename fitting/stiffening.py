"""Tendons whose springs stiffen with stretch, parametrised by the straight lines nearest to their force curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.dynamics.simulate import simulate
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.line_elements import TOE
from pftwin.model.effects.tendon import DampedLine, SpringForce
from pftwin.model.number_place import named_arrays
from pftwin.model.scene import Scene

_TAUT = 2.0  # least distance of the slack length from the mean length at work, in standard deviations of the length
_SHARE = ".stiffening"  # end of its name among the scene's parameters
_SOLVING = 12  # iterations for a slack length, each of which reduces the error tenfold


class StiffeningSpring(NamedTuple):
    """Spring with force F = K s (1 + e s / (L0 / 4)) at the stretch s, with slack length L0 and stiffening e."""

    stiffness: Scalar  # K [N/m]
    more: Scalar  # 4 e / L0 [1/m]

    def at(self, stretch: Scalar) -> SpringForce:
        """Force, stiffness and energy at a stretch [m]."""
        k, m, s = self.stiffness, self.more, stretch
        return SpringForce(k * s * (1 + m * s), k * (1 + 2 * m * s), k * s * s * (0.5 + m * s / 3))


class Working(NamedTuple):
    """Statistics of the lengths at which a tendon works in a motion."""

    mean: Any  # [m]
    variance: Any  # [m^2]
    skew: Any  # the third central moment over the variance [m]

    @staticmethod
    def of(lengths: Floats) -> Working:
        """Statistics of lengths (n,) over the frames [m]."""
        off = lengths - lengths.mean()
        variance = float(np.mean(off**2))
        return Working(float(lengths.mean()), variance, float(np.mean(off**3)) / max(variance, 1e-300))

    def taut(self, slack_length: Any) -> Any:
        """Whether a tendon with this slack length is taut at all lengths, judged by their standard deviation."""
        return self.mean - slack_length > _TAUT * jnp.sqrt(self.variance)

    def bent(self, stiffness: Scalar, slack_length: Scalar, share: Scalar) -> tuple[StiffeningSpring, Scalar]:
        """The stiffening spring whose nearest line at these lengths, by least squares, has this stiffness and slack
        length; and the spring's own slack length. `share`: extra stiffness at a stretch of a quarter of the length.

        With m = 4 e / L, D from L to the mean length, v the lengths' variance and c their skew, a slack length lies at

            d = 2 (D (1 + m c) - m v) / (1 - 2 m D + sqrt((1 - 2 m D)^2 + 4 m (D (1 + m c) - m v)))

        below the mean, and the stiffness is that of the line over 1 + m (2 d + c). A tendon that is slack at some of
        the lengths stays linear.
        """
        stretch = self.mean - slack_length
        m = jnp.where(self.taut(slack_length), 4 * share / slack_length, 0.0)
        b, a = 1 - 2 * m * stretch, stretch * (1 + m * self.skew) - m * self.variance
        square = b * b + 4 * m * a
        d = 2 * a / (b + jnp.sqrt(jnp.where(square > 0, square, 1.0)))
        return StiffeningSpring(stiffness / (1 + m * (2 * d + self.skew)), m), self.mean - d

    def converted_to(
        self, other: Working, stiffness: Scalar, slack_length: Scalar, share: Scalar
    ) -> tuple[Scalar, ...]:
        """The same spring described at other lengths: stiffness and slack length of its nearest line there, and the
        share with which `other.bent` returns the spring."""
        law, own = self.bent(stiffness, slack_length, share)
        k, m, d = law.stiffness, law.more, other.mean - own
        line = k * (1 + m * (2 * d + other.skew))
        slack = other.mean - k * (d + m * (d * d + other.variance)) / line
        return line, slack, m * slack / 4


class StiffeningTendon(DampedLine):
    """A tendon that stiffens with stretch, described by the stiffness and slack length of its nearest straight line.

    The line is nearest over the lengths at which the tendon works: what a model with linear springs would have there.
    """

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))  # of the line
    slack_length: Scalar = eqx.field(metadata=quantity("m", positive=True, alias="L"))  # of the line
    damping: Scalar = eqx.field(metadata=quantity("N s/m", at_least=0))  # c
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    stiffening: Scalar = eqx.field(metadata=quantity("", at_least=0))  # e, at a stretch of a quarter of its length
    mean_length: Scalar = eqx.field(metadata=quantity("m"))  # over the lengths at work: see `Working`
    length_variance: Scalar = eqx.field(metadata=quantity("m^2"))
    length_skew: Scalar = eqx.field(metadata=quantity("m"))
    body: str = eqx.field(static=True)
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)

    def _bent(self) -> tuple[StiffeningSpring, Scalar]:
        working = Working(self.mean_length, self.length_variance, self.length_skew)
        return working.bent(self.stiffness, self.slack_length, self.stiffening)

    @property
    def law(self) -> StiffeningSpring:
        """The stiffening spring."""
        return self._bent()[0]

    @property
    def rest_length(self) -> Scalar:
        """Length at which the tendon begins to pull [m]."""
        return self._bent()[1]

    def lengthened(self, by: Scalar | float) -> Self:
        """See `ElasticLine`: the lengths at which it works grow as much."""
        longer = self.slack_length + by, self.mean_length + by
        return eqx.tree_at(lambda t: (t.slack_length, t.mean_length), self, longer)

    def slack_length_for(self, length: Scalar, tension: Scalar) -> Scalar:
        """See `ElasticLine`: slack length of the line with which the spring itself has this tension [N]."""
        found = length - tension / self.stiffness
        for _ in range(_SOLVING):
            there = eqx.tree_at(lambda t: t.slack_length, self, found)
            found = found + (there.held_tension(length) - tension) / self.stiffness
        return found


def linear_tendons(scene: Scene) -> tuple[str, ...]:
    """Names of the single tendons with linear springs: those that offer a toe region."""
    lines = [e for e in scene.effects if any(change.label == TOE for change in e.elaborations())]
    return tuple(e.name for e in lines if (line := e.line_element()) is not None and line.count is None)


def stiffening_tendons(scene: Scene) -> tuple[str, ...]:
    """Names of the tendons that stiffen."""
    return tuple(name.removesuffix(_SHARE) for name in named_arrays(scene) if name.endswith(_SHARE))


def stiffened(scene: Scene, working: Mapping[str, Working], stiffenings: Mapping[str, Any]) -> Scene:
    """The scene with each linear tendon of known working lengths replaced by one that stiffens by its share at a
    stretch of a quarter of its length. Pure in the numbers."""
    for name in linear_tendons(scene):
        if name in working:
            e: Any = scene.effect(name)
            own = e.stiffness, e.slack_length, e.damping, e.insertion, e.origin
            share, mean, variance, skew = (jnp.asarray(x, float) for x in (stiffenings[name], *working[name]))
            bent = StiffeningTendon(*own, share, mean, variance, skew, e.body, wrap=e.wrap, name=name)
            scene = scene.with_effect(bent)
    return scene


def working_of(scenes: Sequence[Scene], names: Sequence[str]) -> dict[str, Working]:
    """Working lengths of these tendons, from simulations of the motions of these scenes."""
    runs = [simulate(scene).lengths for scene in scenes]
    return {name: Working.of(np.concatenate([r[name] for r in runs])) for name in names}
