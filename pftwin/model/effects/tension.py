"""Prescribed tensions: muscles whose tension over time, or by the knee's flexion, is measured, fitted or modelled."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.errors import InputError
from pftwin.base.quantities import quantity
from pftwin.base.spatial import Scalar, Vec3
from pftwin.geometry.wrapping.obstacle import Obstacle
from pftwin.model.effects.base import Instant, Load, Observable
from pftwin.model.effects.line_elements import LineElement


class PrescribedTension(LineElement):
    """Lines with prescribed tensions, from origins that may move on their body (wrapping muscles).

    Over time: `tension` and each coordinate of `origin` have shape (n_samples, n_lines), those of `insertion`
    (n_lines,). Tension and origin are interpolated linearly between samples, and constant before the first and after
    the last.

    By flexion, with `knots`: `tension` (n_knots,) is that of all lines together at these flexions of the knee, and line
    i bears `share[i]` of it. It is linear between the knots and constant beyond them: continuous, with a slope that
    jumps at the knots. Its derivative with respect to a knot's tension is a hat function, also continuous. `origin` may
    still move over time; one that does not has one sample.

    A tension that the patella's pose does not change has no potential: no energy is stored, and its work counts as
    external work.

    Raises:
        InputError: fewer than two knots, knots that do not rise or beyond 180 deg; another number of tensions than of
            knots; knots without a share for each line, or shares without knots.
    """

    tension: Scalar = eqx.field(metadata=quantity("N", at_least=0))
    origin: Vec3 = eqx.field(metadata=quantity("m", frame="body"))
    insertion: Vec3 = eqx.field(metadata=quantity("m", frame="patella"))
    start_time: float = eqx.field(static=True)
    interval: float = eqx.field(static=True)  # [s]
    body: str = eqx.field(static=True)
    wrap: Obstacle | None = eqx.field(default=None, kw_only=True)
    knots: tuple[float, ...] | None = eqx.field(static=True, default=None, kw_only=True)  # [rad]; None: over time
    share: Scalar | None = eqx.field(metadata=quantity("1", at_least=0), default=None, kw_only=True)  # (n_lines,)
    observables: ClassVar[dict[str, Observable]] = {"tension": Observable("N", "sum of the prescribed tensions")}

    def __check_init__(self) -> None:
        if (self.knots is None) != (self.share is None):
            raise InputError("knots or shares alone", where=self.name, expected="both, for a tension by flexion")
        if self.knots is None or self.share is None:
            return
        check_knots(np.degrees(self.knots), self.name)
        given, lines = np.shape(self.tension), np.shape(self.insertion.x)
        if given != (len(self.knots),):
            count = given[0] if len(given) == 1 else f"an array of shape {given} of"
            found = f"{count} tensions at {len(self.knots)} flexions"
            raise InputError(found, where=self.name, expected="one for each")
        if np.shape(self.share) != lines:
            found = f"shares of shape {np.shape(self.share)}"
            raise InputError(found, where=self.name, expected=f"one for each line, {lines}")

    def at(self, time: Scalar | float) -> tuple[Scalar, Vec3]:
        """Tensions [N] and origins [m] at a time [s], each (n_lines,); InputError for a tension by flexion."""
        if self.knots is not None:
            raise InputError("a tension by flexion has no value at a time", where=self.name, remedy="tensions(now)")
        return self._sampled(self.tension, time), self.origin_at(time)

    def tensions(self, now: Instant) -> Scalar:
        """Tension of each line at an instant [N], (n_lines,)."""
        if self.knots is None or self.share is None:
            return self._sampled(self.tension, now.time)
        low, high = np.asarray(self.knots[:-1]), np.asarray(self.knots[1:])
        passed = jnp.clip((now.knee_flexion() - low) / (high - low), 0.0, 1.0)  # share of each interval that is passed
        return self.share * (self.tension[0] + jnp.sum(passed * jnp.diff(self.tension)))

    def origin_at(self, time: Scalar | float) -> Vec3:
        """Origins of the lines at a time [s], in their body's frame [m]."""
        return self._sampled(self.origin, time)

    def _sampled(self, series: Any, time: Scalar | float) -> Any:
        """Series over time, (n_samples, n_lines) each, at a time [s]."""
        position = (time - self.start_time) / self.interval
        last = jax.tree.leaves(series)[0].shape[0] - 1
        whole = jnp.clip(jnp.floor(position), 0.0, max(last - 1.0, 0.0))
        index, fraction = jnp.asarray(whole, int), jnp.clip(position - whole, 0.0, 1.0)

        def sample(values: Scalar) -> Scalar:
            return values[index] + fraction * (values[jnp.minimum(index + 1, last)] - values[index])

        return jax.tree.map(sample, series)

    def pulls(self) -> Any:
        """Which lines (n_lines,) have a tension above zero at some sample or knot."""
        some = np.any(np.asarray(self.tension) > 0, axis=0)
        return some if self.share is None else some & (np.asarray(self.share) > 0)

    def load(self, now: Instant, memory: Any) -> tuple[Load, Any]:
        """See `Effect`: a wrench without stiff terms, as the patella's pose does not change the tensions."""
        tension, line = self.tensions(now), self.line(now)
        zero = jnp.zeros_like(tension)
        term = line.term(tension, tension, zero, zero)
        return Load(wrench=term.wrench()), memory

    def observe(self, now: Instant, memory: Any) -> dict[str, Scalar]:
        """Total tension."""
        return {"tension": jnp.sum(self.tensions(now))}


def check_knots(flexions: ArrayLike, where: str) -> tuple[float, ...]:
    """Returns flexions (n,) [deg]; raises InputError unless these are two or more that rise, of at most 180."""
    try:
        found = np.asarray(flexions, dtype=float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if found.ndim != 1 or found.size < 2 or not np.all(np.diff(found) > 0) or not np.all(np.abs(found) <= 180):
        listed = flexions if found.ndim != 1 else ", ".join(f"{flexion:g}" for flexion in found) or "none"
        expected = "at least two flexions, each larger than the one before, from -180 to 180 deg"
        raise InputError(f"tensions at flexions of {listed} deg", where=where, expected=expected)
    return tuple(found.tolist())
