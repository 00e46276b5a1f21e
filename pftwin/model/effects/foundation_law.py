r"""Elastic foundation laws: pressure, its derivative and energy per area as functions of depth.

An elastic foundation is a bed of independent springs. A thin layer of modulus E, Poisson ratio nu and thickness h,
bonded to a rigid backing, is confined. With the confined modulus K = E (1 - nu) / ((1 + nu) (1 - 2 nu)) it bears

| law | pressure of one layer at depth d | |
|---|---|---|
| LinearFoundation | K d / h | small strains |
| LogarithmicFoundation | -K ln(1 - d / h) | stiffens towards d = h |

Two layers in contact, one on each body, bear the same pressure, and their depths add up. Sources: Bei and
Fregly 2004, Med Eng Phys 26:777; for two layers Smith, Choi, Negrut and Thelen 2018, Comput Methods Biomech Biomed
Eng Imaging Vis 6:491.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from pftwin.base.errors import InputError
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar

SQUEEZED = 0.95  # fraction of the total thickness beyond which the logarithmic law follows its tangent, to stay finite
_MOST_STEPS = 40  # equal layers take 1 step, moduli that differ by a factor of 1000 at most 12
_CONVERGED = 1e4  # tolerance in units of machine epsilon, as one more step squares the remaining error


class Layer(eqx.Module):
    """An elastic layer on a rigid backing."""

    modulus: Scalar = eqx.field(metadata=quantity("Pa", positive=True, words="Young's modulus"))  # E
    poisson: Scalar = eqx.field(metadata=quantity("", at_least=0, words="Poisson's ratio"))  # nu, below 0.5
    thickness: Scalar = eqx.field(metadata=quantity("m", positive=True))  # h

    def confined_modulus(self) -> Scalar:
        """K [Pa]: ratio of stress to strain without lateral expansion."""
        return self.modulus * (1 - self.poisson) / ((1 + self.poisson) * (1 - 2 * self.poisson))


class FoundationPressure(NamedTuple):
    """Pressure of a foundation law at a depth."""

    pressure: Scalar  # p, at least 0 [Pa]
    slope: Scalar  # dp/dd [Pa/m]
    energy: Scalar  # stored per area [J/m^2]


class FoundationLaw(eqx.Module):
    """Base class of laws for two layers in series, one on each body."""

    femur: Layer
    button: Layer

    @abstractmethod
    def press(self, depth: Scalar) -> FoundationPressure:
        """Pressure at depths [m] of any shape; all results are 0 where the depth is at most 0."""

    def thickness(self) -> Scalar:
        """Sum of both thicknesses [m]."""
        return self.femur.thickness + self.button.thickness

    def compliance(self) -> Scalar:
        """Depth per pressure of both layers together, at zero load [m/Pa]."""
        return self._sum_layers(lambda layer: layer.thickness / layer.confined_modulus())

    def _sum_layers(self, part: Callable[[Layer], Scalar]) -> Scalar:
        return part(self.femur) + part(self.button)


class LinearFoundation(FoundationLaw):
    """p = d / (h1 / K1 + h2 / K2)."""

    def press(self, depth: Scalar) -> FoundationPressure:
        """See `FoundationLaw`."""
        d, slope = jnp.maximum(depth, 0.0), 1 / self.compliance()
        return FoundationPressure(slope * d, jnp.where(depth > 0, slope, 0.0), 0.5 * slope * d * d)


class LogarithmicFoundation(FoundationLaw):
    """p solves h1 (1 - exp(-p / K1)) + h2 (1 - exp(-p / K2)) = d, from p = -K ln(1 - d / h) in each layer.

    Beyond the fraction `SQUEEZED` of the total thickness it follows its tangent, which is finite but not realistic.
    """

    def press(self, depth: Scalar) -> FoundationPressure:
        """See `FoundationLaw`."""
        touching = depth > 0
        d = jnp.where(touching, depth, 0.0)
        within = jnp.minimum(d, SQUEEZED * self.thickness())
        p, beyond = self._solved(within), d - within
        slope = 1 / self._depth_slope(p)
        energy = self._sum_layers(lambda layer: _energy(layer, p)) + beyond * (p + 0.5 * slope * beyond)
        answer = FoundationPressure(p + slope * beyond, slope, energy)
        return FoundationPressure(*(jnp.where(touching, a, 0.0) for a in answer))

    def _solved(self, d: Scalar) -> Scalar:
        """Pressure at depths up to `SQUEEZED` of the total thickness, by Newton's method.

        With g(p) = h1 exp(-p / K1) + h2 exp(-p / K2), ln g is convex and decreasing, and g goes from h1 + h2 to
        h1 + h2 - d at the solution: Newton steps from below never overshoot. Only the last step is differentiated,
        which gives the derivatives of the implicit function.
        """
        frozen, at = stop_gradient((self, d))
        enough = _CONVERGED * float(jnp.finfo(at.dtype).eps)

        def unfinished(now: tuple[Scalar, Scalar, Scalar]) -> Scalar:
            p, before, step = now
            return (step < _MOST_STEPS) & jnp.any(jnp.abs(p - before) > enough * p)

        def improve(now: tuple[Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar, Scalar]:
            p, _, step = now
            return frozen._step(p, at), p, step + 1

        least = frozen._least(at)
        first = frozen._step(least, at), least, jnp.zeros((), jnp.int32)
        p = jax.lax.while_loop(unfinished, improve, first)[0]
        return self._step(stop_gradient(p), d)

    def _least(self, d: Scalar) -> Scalar:
        """A lower bound of the solution: the pressure of two layers of the lower modulus or, if larger, the one that
        one layer bears when the other has thickness zero.
        """
        layers = (self.femur, self.button)
        lower = jnp.minimum(*(layer.confined_modulus() for layer in layers))
        p = -lower * jnp.log1p(-d / self.thickness())
        for own, other in (layers, layers[::-1]):
            rest = jnp.maximum(d - other.thickness, 0.0)
            p = jnp.maximum(p, -own.confined_modulus() * jnp.log1p(-rest / own.thickness))
        return p

    def _step(self, p: Scalar, d: Scalar) -> Scalar:
        left = self._sum_layers(lambda layer: layer.thickness * jnp.exp(-p / layer.confined_modulus()))
        # ln(g / (h1 + h2 - d)) without cancellation at small depths.
        short = d + self._sum_layers(lambda layer: layer.thickness * jnp.expm1(-p / layer.confined_modulus()))
        gain = stop_gradient(left) / stop_gradient(self._depth_slope(p))
        return p + gain * jnp.log1p(short / (self.thickness() - d))

    def _depth_slope(self, p: Scalar) -> Scalar:
        """dd/dp [m/Pa]."""

        def of_one(layer: Layer) -> Scalar:
            k = layer.confined_modulus()
            return layer.thickness / k * jnp.exp(-p / k)

        return self._sum_layers(of_one)


def _energy(layer: Layer, p: Scalar) -> Scalar:
    """h K (1 - (1 + p / K) exp(-p / K)): the integral of p over a layer's depth, without cancellation at small p."""
    k = layer.confined_modulus()
    x = p / k  # its derivative needs exp(-p / k) below, not exp(-x), to cancel at small p
    return layer.thickness * k * (-jnp.expm1(-x) - x * jnp.exp(-p / k))


LAWS: dict[str, type[FoundationLaw]] = {"linear": LinearFoundation, "logarithmic": LogarithmicFoundation}


def checked_layer(modulus: float, poisson: float, thickness: float, *, where: str = "layer") -> Layer:
    """A layer with validated parameters: modulus [Pa], Poisson's ratio and thickness [m].

    Raises:
        InputError: the modulus or thickness is not positive and finite, or Poisson's ratio is outside [0, 0.5).
    """
    for name, value, unit in (("modulus", modulus, "Pa"), ("thickness", thickness, "m")):
        if not 0 < value < float("inf"):
            raise InputError(f"{name} {value!r}", where=where, expected=f"above 0 {unit}")
    if not 0 <= poisson < 0.5:
        raise InputError(
            f"Poisson ratio {poisson!r}",
            where=where,
            expected="0 to below 0.5: a confined layer that keeps its volume cannot be pressed",
        )
    as_float = jax.dtypes.canonicalize_dtype(float)
    return Layer(*(jnp.asarray(v, dtype=as_float) for v in (modulus, poisson, thickness)))
