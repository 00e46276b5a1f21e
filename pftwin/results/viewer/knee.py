"""k3d objects of a result: bones, button, tendons, contact points, forces and contact paths; femur frame, mm."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats
from pftwin.base.errors import MissingExtraError
from pftwin.results.viewer import bones
from pftwin.results.viewer.recorded import ContactArrow, Recorded
from pftwin.results.viewer.shapes import (
    MM,
    Matrices,
    Shape,
    arrow_shape,
    at_points,
    ellipsoid,
    line_shape,
    of_arrows,
    path,
    spaced_points,
)

if TYPE_CHECKING:
    from k3d.objects import Drawable

REST = 0.4  # minimum spacing of a path's points; without it, a path at rest has no direction [mm]
AHEAD = 0.6  # share of white in the colour of a contact's whole path


def k3d() -> Any:
    """Imports and returns the package k3d.

    Raises:
        MissingExtraError: k3d is not installed.
    """
    try:
        import k3d as package
    except ImportError as error:
        raise MissingExtraError("k3d", extra="viewer", feature="the 3D viewer") from error
    return package


def colour(code: str) -> int:
    """Converts a colour such as "#0072B2" to k3d's integer."""
    return int(code.lstrip("#"), 16)


def paler(code: str, share: float) -> str:
    """Mixes a colour with a share of white."""
    return _mixed(code, 255, share)


def darker(code: str, share: float) -> str:
    """Mixes a colour with a share of black."""
    return _mixed(code, 0, share)


def _mixed(code: str, level: int, share: float) -> str:
    parts = [int(code[i : i + 2], 16) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(p + share * (level - p)):02X}" for p in parts)


def time_series(times: Floats, values: Iterable[Any]) -> dict[str, Any]:
    """Returns values as a k3d time series: a dict with the time as a string for its key."""
    return {f"{t:.4f}": v for t, v in zip(times, values, strict=True)}


def body(shape: Shape, code: str, *, name: str, group: str, opacity: float = 1.0) -> Any:
    """Returns a shape as a k3d mesh, fixed in the femur frame until it gets model matrices.

    Its attributes accept time series in place of values, which k3d's types do not declare.
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


def moving_shape(shape: Shape, code: str, times: Floats, matrices: Matrices, **options: Any) -> Any:
    """Returns a shape that moves with a body's matrices (n, 4, 4) [mm]."""
    drawn = body(shape, code, **options)
    drawn.model_matrix = time_series(times, matrices)
    return drawn


def where_present(drawn: Any, times: Floats, present: NDArray[np.bool_]) -> Any:
    """Hides an object in the frames where `present` (n,) is False."""
    if not present.all():
        drawn.visible = time_series(times, present.tolist())
    return drawn


def gaps_filled(values: NDArray[Any], present: NDArray[np.bool_]) -> NDArray[Any]:
    """Fills gaps with the last row before them (else the first after), so that hidden objects do not jump."""
    places = np.where(present, np.arange(present.size), -1)
    last = np.maximum.accumulate(places)
    return values[np.where(last < 0, np.argmax(present), last)]


def solid(result: Recorded, part: bones.Solid, code: str | None = None, group: str = "bones") -> Drawable:
    """Draws a solid part that moves with its frame, in its own colour unless another is given."""
    look: dict[str, Any] = {"name": part.name, "group": group, "opacity": part.opacity}
    if part.frame == "femur":
        return body(part.shape, code or part.colour, **look)
    matrices = result.patella if part.frame == "patella" else result.tibia
    return moving_shape(part.shape, code or part.colour, result.times, matrices, **look)


def femur(result: Recorded, *, pressure: bool) -> list[Any]:
    """Draws bone and component; the articulating part (the bone without a component) is coloured by pressure [MPa] or
    overlap depth [mm]."""
    parts = [bones.femur(result), *bones.femoral_component(result)]
    drawn: list[Any] = [solid(result, part) for part in parts]
    for part, mesh in zip(parts[1:] or parts, drawn[1:] or drawn, strict=True):
        depths = bones.depths_on_femur(result, part.shape.vertices.astype(np.float64))
        if depths is not None:
            values = bones.pressures(result, depths) if pressure else depths
            mesh.attribute = time_series(result.times, values.astype(np.float32))
            mesh.color_map = [0.0, *_rgb(part.colour), *(v for at, code in bones.HOT for v in (at, *_rgb(code)))]
            mesh.color_range = [0.0, float(values.max())]
    return drawn


def moved(drawn: Any, aside: float) -> Any:
    """Shifts a fixed or moving object by `aside` in the lateral direction [mm]."""
    way = np.eye(4, dtype=np.float32)
    way[1, 3] = aside
    matrix = drawn.model_matrix
    drawn.model_matrix = {t: way @ m for t, m in matrix.items()} if isinstance(matrix, dict) else way @ matrix
    return drawn


def _rgb(code: str) -> list[float]:
    """A colour for k3d's colour maps, gamma-corrected because k3d shows them darker than plain colours."""
    return [(int(code[i : i + 2], 16) / 255) ** (1 / 2.2) for i in (1, 3, 5)]


def component(result: Recorded, code: str = bones.METAL, group: str = "bones") -> list[Drawable]:
    """Draws the femoral component; the extrapolated part of a surface is paler."""
    found = bones.femoral_component(result)
    return [solid(result, part, code if part.opacity == 1 else paler(code, 0.5), group) for part in found]


def patella(result: Recorded, code: str) -> list[Drawable]:
    """Draws the patella's body, paler if it is opaque, and the button."""
    body, *button = bones.patella_parts(result)
    shade = code if body.opacity < 1 else paler(code, 0.5)
    return [solid(result, body, shade, result.name), *(solid(result, b, group=result.name) for b in button)]


def tendons(result: Recorded, code: str) -> list[Drawable]:
    """Draws tendons, ligaments and muscles, and a tendon's origin on a schematic tibia."""
    drawn = []
    for name, lines in result.lines.items():
        vertices, triangles = line_shape(lines.paths, lines.radius)
        tube = body(Shape(vertices[0], triangles), paler(code, 0.3), name=name.replace("_", " "), group=result.name)
        tube.vertices = time_series(result.times, vertices)
        drawn.append(tube)
        if lines.body == "tibia" and result.mesh("tibia_bone") is None:
            bump = ellipsoid(MM * lines.origin.reshape(-1, 3).mean(axis=0) - [0.0, 0.0, 6.0], [9.5, 6.5, 8.0])
            what = f"{name.replace('_', ' ')}'s origin"
            drawn.append(moving_shape(bump, code, result.times, result.tibia, name=what, group=result.name))
    return drawn


def contacts(result: Recorded, code: str, newtons: float) -> list[Drawable]:
    """Draws contact points, forces on the patella and contact paths; the travelled part of a path is highlighted.

    Args:
        result: the result to draw.
        code: colour.
        newtons: force per 10 mm of arrow [N].
    """
    return [
        part
        for arrow in result.contact_arrows
        if arrow.present.any()
        for part in _contact(result, arrow, code, newtons)
    ]


def _contact(result: Recorded, arrow: ContactArrow, code: str, newtons: float) -> list[Drawable]:
    times, here, group = result.times, arrow.present, result.name
    points, drawn = gaps_filled(arrow.points, here), []
    if arrow.touches:
        ball, places = ellipsoid([0, 0, 0], [1.8] * 3), at_points(points)
        point = moving_shape(ball, code, times, places, name=f"{arrow.name}: point", group=group)
        drawn = [where_present(point, times, here), *_path(result, arrow, code)]
    if arrow.forces is not None:
        arrows = of_arrows(points, gaps_filled(arrow.forces, here) * (10 / newtons))
        what = f"{arrow.name}: force on the patella"
        force = moving_shape(arrow_shape(), darker(code, 0.35), times, arrows, name=what, group=group)
        drawn.append(where_present(force, times, here))
    return drawn


def _path(result: Recorded, arrow: ContactArrow, code: str) -> list[Drawable]:
    """Draws the whole path in a pale colour, and on it the travelled part, which grows with time."""
    points = MM * np.where(arrow.present[:, None], arrow.points, np.nan)
    taken = spaced_points(points, REST)
    times, points = result.times[taken], points[taken | ~arrow.present]
    if times.size < 2:
        return []
    whole, trail = path(points, 0.3), path(points, 0.6)
    travelled = np.searchsorted(times, result.times, side="right")
    rings = trail.vertices.reshape(len(times), -1, 3)
    grown = [rings[np.minimum(np.arange(len(times)), max(k - 1, 0))].reshape(-1, 3) for k in travelled]
    way = body(whole, paler(code, AHEAD), name=f"{arrow.name}: whole path", group=result.name)
    behind = body(trail, code, name=f"{arrow.name}: path", group=result.name)
    behind.vertices = time_series(result.times, grown)
    return [way, behind]
