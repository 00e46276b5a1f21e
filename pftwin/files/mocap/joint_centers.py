"""Functional joint centres: the point about which the markers of an adjacent segment rotate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pftwin.base.errors import InputError

_CAMERAS = 1e-4  # [m] smallest noise assumed for markers, however well a motion fits
_MORE_THAN_NOISE = 2.0  # smallest ratio of a direction's squares to those of noise alone; below, centres are arbitrary


@dataclass(frozen=True, eq=False)
class JointCenter:
    """A joint centre and its accuracy.

    Attributes:
        point: (3,) position in the frame of the markers' coordinates [m].
        deviation: standard deviation in the worst determined direction [m]; infinite if the motion does not determine
            it better than the markers' noise would, as along the axis of a hinge.
        residual_rms: root mean square change of the markers' distances from the centre [m].
        reach: largest rotation of the markers about the centre from the middle of their paths [rad].
    """

    point: NDArray[np.float64]
    deviation: float
    residual_rms: float
    reach: float


def sphere_center(points: ArrayLike, *, source: str = "joint centre") -> JointCenter:
    """Least-squares common centre of the spheres on which markers move, each with its own radius.

    The changes of each marker's distance from the centre are minimised. The search starts at the closed-form solution
    of Gamage and Lasenby (2002, J Biomech 35:87), which minimises changes of squared distances and is biased by noise
    (Halvorsen 2003, J Biomech 36:999).

    The standard deviation is that of least squares with the residuals' variance, or that of 0.1 mm if larger. Since
    residuals of successive frames are correlated (skin motion, filtered markers), the variance is multiplied by
    1 + 2 sum r_k, with their correlations at lags of k frames up to the first that is not positive.

    Args:
        points: (n, m, 3) metres in the frame of the segment in which the centre is fixed; NaN where missing. One marker
            is enough.
        source: for messages.

    Raises:
        InputError: another shape; fewer positions than unknowns (the centre and the distances).
    """
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 3 or p.shape[1:] != (p.shape[1], 3):
        raise InputError(f"markers of shape {p.shape}", where=source, expected="(n, m, 3)")
    frame, marker = np.nonzero(np.isfinite(p).all(axis=2))
    unknown = 3 + np.unique(marker).size
    if marker.size <= unknown:
        found = f"{marker.size} places of {p.shape[1]} markers"
        raise InputError(found, where=source, expected=f"more than {unknown}: a motion about the joint")
    from scipy.optimize import least_squares

    middle = p[frame, marker].mean(axis=0)
    places = p[frame, marker] - middle
    count = np.maximum(np.bincount(marker), 1)

    def about_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (k, ...) minus their mean over each marker's frames."""
        rows = values.reshape(marker.size, -1)
        mean = np.stack([np.bincount(marker, column) / count for column in rows.T], axis=-1)
        return (rows - mean[marker]).reshape(values.shape)

    def distances(center: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(places - center, axis=1)

    def directions(center: NDArray[np.float64]) -> NDArray[np.float64]:
        return (places - center) / np.maximum(distances(center), 1e-12)[:, None]

    start = np.linalg.lstsq(2 * about_mean(places), about_mean(np.sum(places**2, axis=1)), rcond=None)[0]
    found = least_squares(
        lambda center: about_mean(distances(center)),
        start,
        jac=lambda center: -about_mean(directions(center)),  # pyright: ignore[reportArgumentType]
        method="lm",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    change, rays = found.fun, directions(found.x)
    noise = float(np.mean((change / np.maximum(distances(found.x), 1e-12)) ** 2))  # mean squared noise of directions
    deviation = _deviation(about_mean(rays), change, marker, marker.size - unknown, noise)
    largest = _largest_angle(rays, rays - about_mean(rays))
    return JointCenter(middle + found.x, deviation, float(np.sqrt(np.mean(change**2))), largest)


def _largest_angle(rays: NDArray[np.float64], mean: NDArray[np.float64]) -> float:
    """Largest angle between unit vectors (k, 3) and their marker's mean direction (k, 3), of any length [rad]."""
    cosine = np.sum(rays * mean, axis=1) / np.maximum(np.linalg.norm(mean, axis=1), 1e-12)
    return float(np.arccos(np.clip(cosine.min(), -1.0, 1.0)))


def _deviation(
    slopes: NDArray[np.float64],
    change: NDArray[np.float64],
    marker: NDArray[np.intp],
    freedom: int,
    noise: float,
) -> float:
    """Standard deviation [m] in the worst direction, from derivatives (k, 3) and values (k,) of the residuals."""
    least = float(np.linalg.eigvalsh(slopes.T @ slopes)[0])
    if not least > (1e-14 + _MORE_THAN_NOISE * noise) * marker.size:
        return np.inf
    from scipy.signal import correlate

    products = np.zeros(marker.size)  # of residuals at a lag of k frames, summed over all markers
    for each in (change[marker == i] for i in np.unique(marker)):
        products[: each.size] += correlate(each, each)[each.size - 1 :]
    alike = int(np.argmax(np.append(products, 0.0) <= 0))
    squares = products[0] + 2 * products[1:alike].sum()
    return float(np.sqrt(max(squares / freedom, _CAMERAS**2) / least))
