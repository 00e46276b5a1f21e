"""The free parameters of a fit: their places in the scene, bounds and priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray
from scipy.stats import truncnorm

from fitting.nuisance import EXACT, Nuisance
from fitting.stiffening import Working
from pftwin.base.errors import InputError
from pftwin.base.spatial import Scalar
from pftwin.model.number_place import NumberPlace
from pftwin.model.scene import Scene
from pftwin.model.scene_parameters import find

Bounds = float | Mapping[str, float | tuple[float, float]]
DEFAULT_BOUNDS = 0.3
REQUESTED, BETWEEN_TRIALS = "requested parameters", "differences between trials"  # kinds of parameters
_EDGE = 1e-9  # least distance of iterates from the bounds, as a share of the range
_FAR = 3  # standard deviations from the bounds beyond which a prior excludes them


@dataclass(frozen=True)
class Parameter:
    """One free parameter.

    Args:
        name: as the user wrote it ("K1", "quadriceps.origin.y").
        place: where it is in the scene.
        nominal: value in the scene that is fitted, where searches start.
        lower, upper: bounds.
        prior: mean and standard deviation of a normal prior; None: flat.
        unit: of all these values.
        coordinate: whether it is a coordinate of a point, which may lie elsewhere in other scenes.
        kind: `REQUESTED` if requested; otherwise the kind of nuisance, or `BETWEEN_TRIALS`.
        trial: None for a parameter that all trials share; k for the difference of trial k (from 0) from the shared
            parameter at the same place (`fitting.trials`).
    """

    name: str
    place: NumberPlace
    nominal: float
    lower: float
    upper: float
    prior: tuple[float, float] | None = None
    unit: str = ""
    coordinate: bool = False
    kind: str = REQUESTED
    trial: int | None = None


@dataclass(frozen=True)
class Parameters:
    """All free parameters, differences between trials last; parameter vectors have shape (..., p)."""

    items: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.items)

    @property
    def asked(self) -> int:
        """Number of requested parameters, which come first; nuisance parameters follow."""
        return sum(p.kind == REQUESTED for p in self.items)

    @property
    def shared(self) -> Parameters:
        """The parameters that trials share, which come first."""
        return Parameters(tuple(p for p in self.items if p.trial is None))

    @property
    def differences(self) -> tuple[tuple[int, int], ...]:
        """For each difference between trials: index of the shared parameter to which it is added, and trial from 0."""
        at = {p.place: i for i, p in enumerate(self.shared.items)}
        return tuple((at[p.place], p.trial) for p in self.items if p.trial is not None)

    @property
    def varies(self) -> dict[str, float]:
        """Standard deviation between trials of each shared parameter that varies, by name."""
        own = (p.prior for p in self.items if p.trial is not None)
        return {self.items[at].name: prior[1] for (at, _), prior in zip(self.differences, own, strict=True) if prior}

    @property
    def names(self) -> tuple[str, ...]:
        """Names as the user wrote them."""
        return tuple(p.name for p in self.items)

    @property
    def places(self) -> tuple[NumberPlace, ...]:
        """Places of the parameters in the scene."""
        return tuple(p.place for p in self.items)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the parameters that are coordinates of points."""
        return tuple(p.name for p in self.items if p.coordinate)

    @property
    def lower(self) -> NDArray[np.float64]:
        """Lower bounds (p,)."""
        return np.array([p.lower for p in self.items])

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bounds (p,)."""
        return np.array([p.upper for p in self.items])

    @property
    def nominal(self) -> NDArray[np.float64]:
        """Nominal values (p,), where searches start."""
        return np.array([p.nominal for p in self.items])

    def apply(self, scene: Scene, theta: Any) -> Scene:
        """The scene with these values (p,). Pure: jit, vmap and derivatives apply."""
        return applied(self.places, scene, theta)

    def vector(self, scene: Scene) -> NDArray[np.float64]:
        """The parameters' values in a scene (p,)."""
        return np.array([float(place.read(scene)) for place in self.places])

    def share(self, theta: Any) -> NDArray[np.float64]:
        """Values (..., p) as shares of the range between the bounds: 0 at the lower, 1 at the upper."""
        return (np.asarray(theta, dtype=float) - self.lower) / (self.upper - self.lower)

    def at_share(self, share: ArrayLike) -> NDArray[np.float64]:
        """The inverse of `share`."""
        return self.lower + (self.upper - self.lower) * np.asarray(share, dtype=float)

    def to_bounded(self, u: ArrayLike) -> NDArray[np.float64]:
        """Maps real numbers (..., p) to values within the bounds: lower + range / (1 + exp(-u))."""
        share = 0.5 * (1 + np.tanh(0.5 * np.asarray(u, dtype=float)))
        return self.lower + (self.upper - self.lower) * np.clip(share, _EDGE, 1 - _EDGE)

    def to_unbounded(self, theta: ArrayLike) -> NDArray[np.float64]:
        """The inverse of `to_bounded`."""
        share = np.clip(self.share(theta), _EDGE, 1 - _EDGE)
        return np.log(share) - np.log1p(-share)

    def slope(self, theta: ArrayLike) -> NDArray[np.float64]:
        """Derivative of `to_bounded` at values within the bounds (..., p)."""
        theta = np.asarray(theta, dtype=float)
        return (theta - self.lower) * (self.upper - theta) / (self.upper - self.lower)

    def latin_hypercube(self, count: int, random: np.random.Generator) -> NDArray[np.float64]:
        """A Latin hypercube of points (count, p) within the bounds."""
        strata = np.stack([random.permutation(count) for _ in self.items], axis=1)
        share = (strata + random.uniform(size=strata.shape)) / count
        return self.lower + (self.upper - self.lower) * share

    def scattered(self, count: int, random: np.random.Generator) -> NDArray[np.float64]:
        """Points (count, p) to search from: draws where there is a prior, otherwise a Latin hypercube."""
        found = self.latin_hypercube(count, random)
        for i, p in enumerate(self.items):
            if p.prior is not None:
                # Truncated, not clipped: at a bound a search in unbounded parameters would have zero gradient.
                ends = [(bound - p.prior[0]) / p.prior[1] for bound in (p.lower, p.upper)]
                found[:, i] = truncnorm.rvs(*ends, *p.prior, size=count, random_state=random)
        return found

    def prior_terms(self, theta: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
        """Minus the priors' log density at theta (..., p): value (...), gradient (..., p), curvature (p,)."""
        mean = np.array([0.0 if p.prior is None else p.prior[0] for p in self.items])
        precision = np.array([0.0 if p.prior is None else p.prior[1] ** -2 for p in self.items])
        off = theta - mean
        return 0.5 * np.sum(precision * off**2, axis=-1), precision * off, precision


def weights_in(differences: Sequence[tuple[int, int]], shared: int, trial: int) -> NDArray[np.float64]:
    """Matrix W (s, p) that maps parameters theta to the s shared parameters' values in a trial (from 0), W theta;
    `differences` as in `Parameters`."""
    weights = np.eye(shared, shared + len(differences))
    for column, (at, own) in enumerate(differences, start=shared):
        weights[at, column] = own == trial
    return weights


def applied(places: tuple[NumberPlace, ...], scene: Scene, theta: Any) -> Scene:
    """The scene with values (p,) at the places. Lengths given by a force are set last: they need the stiffness."""
    order = sorted(range(len(places)), key=lambda i: places[i].meaning != "value")
    values: list[Scalar] = [theta[i] for i in range(len(places))]
    for i in order:
        scene = places[i].written(scene, values[i])
    return scene


def free_parameters(
    scene: Scene,
    names: Sequence[str],
    bounds: Bounds = DEFAULT_BOUNDS,
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> Parameters:
    """Resolves names of parameters, with bounds and priors.

    Args:
        scene: scene whose values are the nominal ones.
        names: "K1", "L1", "K2", "L2": stiffness and slack length of the first and second tendon; "L2.strain",
            "L2.force": the slack length as strain or force at the scene's start pose; "quadriceps.stiffness",
            "patellar_tendon.origin.y", "contact.radius", "contact.surface.coefficients[3]" (without an index, each
            coefficient is a separate parameter); "pt.slack_length[:]": all of a ligament's strands as one parameter,
            reported as their mean, which keep their proportions; "quadriceps.damping~patellar_tendon.damping": two that
            keep their proportion (coordinates: their distance), of which the first is reported.
        bounds: half width as a share of the nominal value; or by name such a share or (lower, upper), with +-30 % for
            the others.
        priors: mean and standard deviation of a normal prior, by name.

    Raises:
        InputError: an unknown or repeated name; bounds that are empty, exclude the nominal value, or are a share of a
            zero value; an invalid prior, or one that excludes the bounds.
    """
    if isinstance(names, str) or not names:
        raise InputError(f"found {names!r}", where="free", expected='names of parameters, such as ("K1", "L1")')
    items: list[Parameter] = []
    for name in names:
        places = find(scene, name)
        for place in places:
            own = name if len(places) == 1 else f"{name}[{place.index}]"
            if any(p.place.overlaps(place) for p in items):
                raise InputError(f"{own!r} is named twice", where="free", expected="every number once")
            items.append(_parameter(scene, own, name, place, bounds, priors or {}))
    own = [p.name for p in items]
    for given, what in ((bounds, "bounds"), (priors, "priors")):
        if isinstance(given, Mapping) and (stray := [n for n in given if n not in own and n not in names]):
            raise InputError(f"{stray[0]!r} is not free", where=what, expected=f"one of: {', '.join(own)}")
    return Parameters(tuple(items))


def with_nuisance(
    scene: Scene,
    names: Sequence[str],
    bounds: Bounds,
    priors: Mapping[str, tuple[float, float]] | None,
    nuisance: Nuisance,
) -> tuple[Scene, Parameters]:
    """The scene with nuisance effects added, and its free parameters: the requested ones, then nuisance. Raises
    InputError as `free_parameters` and `Nuisance.prepared` do."""
    scene = nuisance.prepared(scene)
    asked = free_parameters(scene, names, bounds, priors)
    more = nuisance.numbers(scene, but=[name for p in asked.items for name in p.place.names])
    if not more.names:
        return scene, asked
    extra = free_parameters(scene, more.names, more.bounds, more.priors).items
    return scene, Parameters((*asked.items, *(replace(p, kind=more.kinds[p.name]) for p in extra)))


def _parameter(
    scene: Scene, own: str, name: str, place: NumberPlace, bounds: Bounds, priors: Mapping[str, tuple[float, float]]
) -> Parameter:
    nominal = float(place.read(scene))
    given: Any = bounds
    if isinstance(bounds, Mapping):
        given = bounds.get(own, bounds.get(name, DEFAULT_BOUNDS))
    lower, upper = _limits(own, nominal, given)
    if not (np.isfinite([lower, upper]).all() and lower < upper):
        raise InputError(f"{own}: bounds {lower:g} to {upper:g} are empty", where="bounds", expected="lower < upper")
    if not lower <= nominal <= upper:
        problem = f"{own}: bounds {lower:g} to {upper:g} exclude the scene's value {nominal:g}, where the search begins"
        remedy = "wider bounds, or a scene with another value"
        raise InputError(problem, where="bounds", expected="bounds around it", remedy=remedy)
    prior = priors.get(own, priors.get(name))
    if prior is not None and not (len(prior) == 2 and np.isfinite(prior).all() and prior[1] > 0):
        raise InputError(f"{own}: found {prior!r}", where="priors", expected="a mean and a positive standard deviation")
    if prior is not None and not lower - _FAR * prior[1] <= prior[0] <= upper + _FAR * prior[1]:
        problem = f"{own}: the prior {prior[0]:g} +- {prior[1]:g} excludes the bounds {lower:g} to {upper:g}"
        expected, remedy = f"a mean within {_FAR} standard deviations of them", "other bounds, or another prior"
        raise InputError(problem, where="priors", expected=expected, remedy=remedy)
    return Parameter(own, place, nominal, lower, upper, prior, place.unit(scene), place.is_coordinate(scene))


def _limits(name: str, nominal: float, given: Any) -> tuple[float, float]:
    if isinstance(given, int | float):
        if not (0 < given < np.inf):
            raise InputError(f"{name}: found {given!r}", where="bounds", expected="a positive share, such as 0.3")
        if nominal == 0:
            expected = f"{{{name!r}: (lower, upper)}}"
            raise InputError(f"{name}: {given:.0%} of its value 0 is nothing", where="bounds", expected=expected)
        return nominal - given * abs(nominal), nominal + given * abs(nominal)
    try:
        lower, upper = (float(v) for v in given)
    except (TypeError, ValueError):
        raise InputError(f"{name}: found {given!r}", where="bounds", expected="a share or (lower, upper)") from None
    return lower, upper


class Applied(eqx.Module):
    """`Estimate.apply`. Its values are arrays, so that one compiled program serves all estimates of the same names.

    A point's coordinate is applied as an offset from the fitted scene's nominal value: a tuberosity that was found 2 mm
    more distal is 2 mm more distal in a treated knee too, and does not undo the treatment.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    values: Array  # (p,)
    working: dict[str, Working]  # working lengths of tendons that stiffen
    origins: tuple[tuple[str, float], ...] = eqx.field(static=True)
    nuisance: Nuisance = eqx.field(static=True)

    def __init__(
        self,
        names: Sequence[str],
        values: ArrayLike,
        origins: tuple[tuple[str, float], ...] = (),
        nuisance: Nuisance = EXACT,
    ) -> None:
        """Takes names and values (p,) of parameters, names of coordinates with their nominal values in the fitted
        scene, and the nuisance effects that other scenes need first."""
        self.names, self.origins = tuple(names), origins
        self.values = jnp.asarray(values, dtype=float)
        self.working = {n: Working(*(jnp.asarray(x, dtype=float) for x in numbers)) for n, numbers in nuisance.working}
        self.nuisance = replace(nuisance, working=())

    def __call__(self, scene: Scene, theta: Any = None) -> Scene:
        """The scene with the estimated values, or with other values (p,) of the fitted scene. Pure in both. Raises
        InputError if the scene has no such parameters."""
        scene = self.nuisance.prepared(scene, self.working)
        places = tuple(find(scene, name)[0] for name in self.names)
        theta = self.values if theta is None else theta
        own, values = dict(self.origins), []
        for i, (name, place) in enumerate(zip(self.names, places, strict=True)):
            values.append(place.read(scene) + (theta[i] - own[name]) if name in own else theta[i])
        return applied(places, scene, values)
