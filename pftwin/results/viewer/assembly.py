"""Assembly of the 3D plot: objects of each result, shared bodies, legend and numbers, settings of the controls."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.results.plots import COLOURS
from pftwin.results.viewer import bones, knee, page
from pftwin.results.viewer.framing import ANGLE, HEIGHT, PAN_SPEED, PATELLA, extent, opening, sides, views
from pftwin.results.viewer.knee import k3d, paler, time_series
from pftwin.results.viewer.recorded import Mesh, Recorded

if TYPE_CHECKING:
    from k3d.objects import Drawable
    from k3d.plot import Plot

GAP = 130.0  # between knees side by side [mm]
LONGEST = 80.0  # approximate length of the arrow of a large force [mm]
_ROUND = (1.0, 2.0, 5.0)
ROOM = [-250.0, -100.0, -200.0, 300.0, 100.0, 150.0]  # bounding box for k3d's camera [mm]
ALIKE = 2.0  # tibias whose origins, and points 100 mm away, differ by less are drawn once [mm]
MOST = 0.98  # quantile of the forces that counts as large


def plot(
    results: Sequence[Recorded], *, side_by_side: bool = False, hidden: Collection[str] = ()
) -> tuple[Plot, dict[str, Any]]:
    """Returns the plot of results and the settings of its page's controls.

    Args:
        results: at least one result.
        side_by_side: draw complete knees next to each other instead of overlaid (`_overlaid`).
        hidden: names of results that stay hidden until their box is checked.
    """
    codes = [COLOURS[i % len(COLOURS)] for i in range(len(results))]
    newtons = per_centimetre(results)
    separate = side_by_side or len(results) == 1
    shared, own = _separate(results, codes, newtons) if separate else _overlaid(results, codes, newtons)
    coloured = _coloured(own)
    most = max((float(p.color_range[1]) for p in coloured), default=None)
    bare = f"#{coloured[0].color:06X}" if coloured else None
    said = page.notes(results, newtons, most)
    times = np.unique(np.round(np.concatenate([r.times for r in results]), 4))
    several = separate and len(results) > 1
    shown = views(results[0], several=several)
    everything = [*shared, *(part for parts in own for part in parts)]
    corners = extent(everything, shown["anterior"][3])
    made = k3d().plot(
        background_color=0xFFFFFF,
        grid_visible=False,
        camera_auto_fit=False,
        grid_auto_fit=False,
        colorbar_object_id=0,  # not k3d's colour bar: the legend has one
        grid=_room(len(results) if separate else 1),
        camera_fov=ANGLE,
        camera_pan_speed=PAN_SPEED,
        axes_helper=0.0,
        lighting=1.4,
        height=680,
        time=float(times[0]),
        name=page.title(results),
        camera=[],  # the controls set it, to fit the page; k3d would set one given here again, after them
    )
    for drawn in [*everything, *sides(shown["anterior"][3:6], corners)]:
        made += drawn
    made += _text_label("legend", page.legend(results, codes, said, bare), (0.01, 0.015), "lt")
    numbers = time_series(times, [page.readout(results, codes, t) for t in times])
    made += _text_label("numbers", numbers, (0.99, 0.985), "rb")
    control = {
        "begin": float(times[0]),
        "end": float(times[-1]),
        "opening": opening(results),
        "views": shown,
        "angle": ANGLE,
        "height": HEIGHT["several" if several else "one"],
        "extent": corners.tolist(),
        "results": [
            {"name": r.name, "colour": c, "ids": [p.id for p in parts], "hidden": r.name in hidden}
            for r, c, parts in zip(results, codes, own, strict=True)
        ],
        "patellae": [p.id for parts in own for p in parts if p.name in PATELLA],
        "see_through": bool(coloured),  # an opaque patella covers the colours on the femur
    }
    return made, control


def _overlaid(
    results: Sequence[Recorded], codes: Sequence[str], newtons: float
) -> tuple[list[Drawable], list[list[Drawable]]]:
    """Shared objects and the objects of each result: femur, component and tibia of the first result are shared by all
    results in which they are the same; other results have their own, in their colour.
    """
    first = results[0]
    alike = [r for r in results if _same_meshes(first, r, "femur", "surface")]
    farthest = max(alike, key=lambda r: r.geometry.sizes.get("continuation_vertex", 0))
    shared = [knee.solid(first, bones.femur(first)), knee.solid(first, bones.tibia(first)), *knee.component(farthest)]
    own = []
    for result, code in zip(results, codes, strict=True):
        parts = _moving(result, code, newtons)
        if result is not first and not (_same_motion(first, result) and _same_meshes(first, result, "tibia_bone")):
            parts.append(knee.solid(result, bones.tibia(result), paler(code, 0.5)))
        if not _same_meshes(first, result, "femur_bone"):
            parts.append(knee.solid(result, bones.femur(result), paler(code, 0.5)))
        if result not in alike:
            parts += knee.component(result, paler(code, 0.5), result.name)
        own.append(parts)
    return shared, own


def _separate(
    results: Sequence[Recorded], codes: Sequence[str], newtons: float
) -> tuple[list[Drawable], list[list[Drawable]]]:
    """No shared objects; each knee has its own bones, coloured where the patella presses on the femur."""
    own = []
    pressure = bones.tells_pressure(results)
    for k, (result, code) in enumerate(zip(results, codes, strict=True)):
        parts = [
            *_moving(result, code, newtons),
            knee.solid(result, bones.tibia(result)),
            *knee.femur(result, pressure=pressure),
        ]
        own.append([knee.moved(part, _place(k, len(results))) for part in parts])
    most = max((float(p.color_range[1]) for p in _coloured(own)), default=0.0)
    for part in _coloured(own):
        part.color_range = [0.0, most]  # the same scale for all
    return [], own


def _coloured(own: list[list[Any]]) -> list[Any]:
    """Parts with a colour scale."""
    return [part for parts in own for part in parts if len(part.color_range)]


def _moving(result: Recorded, code: str, newtons: float) -> list[Drawable]:
    return [*knee.patella(result, code), *knee.tendons(result, code), *knee.contacts(result, code, newtons)]


def _place(k: int, count: int) -> float:
    """Lateral offset of the k-th of several knees [mm]; in the anterior view the first is on the left."""
    return GAP * (0.5 * (count - 1) - k)


def _room(count: int) -> list[float]:
    """Bounding box for k3d's camera [mm]."""
    aside = GAP * 0.5 * (count - 1)
    return [ROOM[0], ROOM[1] - aside, ROOM[2], ROOM[3], ROOM[4] + aside, ROOM[5]]


def per_centimetre(results: Sequence[Recorded]) -> float:
    """Returns the force per 10 mm of arrow [N]: 1, 2 or 5 times a power of ten, so that arrows fit `LONGEST`."""
    found = [(arrow.forces, arrow.present) for r in results for arrow in r.contact_arrows]
    sizes = [np.linalg.norm(f[here], axis=1) for f, here in found if f is not None]
    most = max((float(np.quantile(s, MOST)) for s in sizes if s.size), default=1.0)
    exact = 10 * most / LONGEST
    power = 10.0 ** np.floor(np.log10(exact))
    return float(power * next((k for k in _ROUND if k * power >= exact), 10.0))


def _text_label(name: str, text: str | dict[str, str], place: tuple[float, float], corner: str) -> Any:
    return k3d().text2d(
        text, position=place, reference_point=corner, is_html=True, label_box=True, size=1.0, color=0x222222, name=name
    )


def _same_meshes(one: Recorded, two: Recorded, *names: str) -> bool:
    """Whether two results have the same meshes at the same position, within a micrometre."""
    return all(_same_mesh(one.mesh(name), two.mesh(name)) for name in names)


def _same_mesh(a: Mesh | None, b: Mesh | None) -> bool:
    if a is None or b is None:
        return a is b
    return a[0].shape == b[0].shape and bool(np.allclose(a[0], b[0], atol=1e-6, rtol=0))


def _same_motion(one: Recorded, two: Recorded) -> bool:
    """Whether two results' tibias move so similarly that one of them is drawn for both."""
    if one.tibia.shape != two.tibia.shape:
        return False
    turned = one.tibia[:, :3, :3] - two.tibia[:, :3, :3]
    return bool(np.abs(turned).max() < ALIKE / 100 and np.abs(one.tibia - two.tibia)[:, :3, 3].max() < ALIKE)
