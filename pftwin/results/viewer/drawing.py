"""Objects of k3d from shapes: still, carried along by poses, or changing with time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.errors import MissingExtraError

if TYPE_CHECKING:
    from pftwin.results.viewer.matrices import Matrices
    from pftwin.results.viewer.shapes import Shape

Floats = NDArray[np.float64]


def k3d() -> Any:
    """The package.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import k3d as package
    except ImportError as error:
        raise MissingExtraError("k3d", extra="viewer", feature="the 3D viewer") from error
    return package


def colour(code: str) -> int:
    """ "#0072B2" as k3d has it."""
    return int(code.lstrip("#"), 16)


def paler(code: str, share: float) -> str:
    """A colour mixed with so much white."""
    return _mixed(code, 255, share)


def darker(code: str, share: float) -> str:
    """A colour mixed with so much black."""
    return _mixed(code, 0, share)


def _mixed(code: str, level: int, share: float) -> str:
    parts = [int(code[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(p + share * (level - p)):02X}" for p in parts)


def keyed(times: Floats, values: Iterable[Any]) -> dict[str, Any]:
    """Values by time, as k3d has time series; one that never changes is no series."""
    return {f"{t:.4f}": v for t, v in zip(times, values, strict=True)}


def body(shape: Shape, code: str, *, name: str, group: str, opacity: float = 1.0) -> Any:
    """A shape that stands still in the femur, until it is given model matrices.

    What comes back takes time series wherever it takes values, which its types do not say.
    """
    return k3d().mesh(
        shape.vertices,
        shape.triangles,
        color=colour(code),
        opacity=opacity,
        flat_shading=False,
        side="double",
        roughness=0.55,
        name=name,
        group=group,
        compression_level=0,  # the whole page is compressed
    )


def carried(shape: Shape, code: str, times: Floats, matrices: Matrices, **options: Any) -> Any:
    """A shape that moves with a body."""
    drawn = body(shape, code, **options)
    drawn.model_matrix = keyed(times, matrices)
    return drawn


def where_present(drawn: Any, times: Floats, present: NDArray[np.bool_]) -> Any:
    """The object, hidden in frames in which there is nothing."""
    if not present.all():
        drawn.visible = keyed(times, present.tolist())
    return drawn


def held(values: NDArray[Any], present: NDArray[np.bool_]) -> NDArray[Any]:
    """Rows with gaps filled by the nearest row before (else after), so that nothing hidden jumps into view."""
    places = np.where(present, np.arange(present.size), -1)
    last = np.maximum.accumulate(places)
    return values[np.where(last < 0, np.argmax(present), last)]
