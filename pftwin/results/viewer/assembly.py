"""The whole plot: the objects of every result, shared bodies drawn once, legend, numbers and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.results.plots import COLOURS
from pftwin.results.viewer import bones, knee, page
from pftwin.results.viewer.knee import k3d, paler, time_series
from pftwin.results.viewer.recorded import Mesh, Recorded
from pftwin.results.viewer.shapes import MM

if TYPE_CHECKING:
    from k3d.plot import Plot

DISTANCE = 370.0  # of the camera [mm]
# Where the camera stands from the joint, and what is up: femur axes x proximal, y lateral, z anterior.
_FROM = {
    "anterior": ((0.12, 0.12, 1.0), (1, 0, 0)),
    "lateral": ((0.05, 1.0, 0.15), (1, 0, 0)),
    "medial": ((0.05, -1.0, 0.15), (1, 0, 0)),
    "skyline": ((-1.0, 0.0, 0.25), (0, 0, 1)),
}
LONGEST = 80.0  # of an arrow [mm], about
_ROUND = (1.0, 2.0, 5.0)
ROOM = [-250.0, -100.0, -200.0, 300.0, 100.0, 150.0]  # that k3d's camera sees [mm]
ALIKE = 2.0  # tibias that are never farther apart are drawn once: their origins, and what is 100 mm away [mm]
MOST = 0.98  # share of the forces that are not longer than that
SIDE = 68.0  # of the words "lateral" and "medial" from the middle [mm]


def views(result: Recorded) -> dict[str, list[float]]:
    """Cameras by name: place, target, up, nine numbers each [mm]."""
    center = MM * np.nanmean(result.data["sphere_center"].values, axis=0)
    target = np.array([center[0] + 8.0, center[1] * 0.5, center[2] - 12.0])
    found = {}
    for name, (toward, up) in _FROM.items():
        place = target + DISTANCE * np.asarray(toward) / np.linalg.norm(toward)
        found[name] = [float(v) for v in (*place, *target, *up)]
    return found


def plot(results: Sequence[Recorded]) -> tuple[Plot, dict[str, Any]]:
    """The plot of results, and what its page's controls have to know.

    Args:
        results: at least one. The femur's shaft is that of the first, and so are its component and the tibia for those
            that have them alike; others have their own, in their colour.
    """
    codes = [COLOURS[i % len(COLOURS)] for i in range(len(results))]
    newtons = per_centimetre(results)
    first = results[0]
    alike = [r for r in results if _same_component(first, r)]
    farthest = max(alike, key=lambda r: r.geometry.sizes.get("continuation_vertex", 0))
    shafts = knee.solid(first, bones.femur(first)), knee.solid(first, bones.tibia(first))
    objects = [*shafts, *knee.component(farthest)]
    own = []
    for result, code in zip(results, codes, strict=True):
        parts = [*knee.patella(result, code), *knee.tendons(result, code), *knee.contacts(result, code, newtons)]
        if result is not first and not _same_motion(first, result):
            parts.append(knee.solid(result, bones.tibia(result), paler(code, 0.5)))
        if result not in alike:
            parts += knee.component(result, paler(code, 0.5), result.name)
        own.append(parts)
    said = page.notes(results, newtons)
    times = np.unique(np.round(np.concatenate([r.times for r in results]), 4))
    shown = views(first)
    made = k3d().plot(
        background_color=0xFFFFFF,
        grid_visible=False,
        camera_auto_fit=False,
        grid_auto_fit=False,
        colorbar_object_id=0,  # none: the path's colours are not values
        grid=ROOM,
        camera_fov=30.0,
        axes_helper=0.0,
        lighting=1.4,
        height=680,
        time=float(times[0]),
        name=page.title(results),
        camera=shown["anterior"],
    )
    for drawn in [*objects, *(part for parts in own for part in parts)]:
        made += drawn
    for side, y in (("lateral", SIDE), ("medial", -SIDE)):
        x, _, z = shown["anterior"][3:6]
        place = {"position": [x, y, z], "reference_point": "cc"}
        made += k3d().text(page.side(side), **place, color=0x888888, size=0.9, is_html=True, label_box=False, name=side)
    made += _text_label("legend", page.legend(results, codes, said), (0.01, 0.015), "lt")
    numbers = time_series(times, [page.readout(results, codes, t) for t in times])
    made += _text_label("numbers", numbers, (0.99, 0.015), "rt")
    control = {
        "begin": float(times[0]),
        "end": float(times[-1]),
        "views": shown,
        "results": [
            {"name": r.name, "colour": c, "ids": [p.id for p in parts]}
            for r, c, parts in zip(results, codes, own, strict=True)
        ],
    }
    return made, control


def per_centimetre(results: Sequence[Recorded]) -> float:
    """Newtons to 10 mm of arrow: 1, 2 or 5 times a power of ten, a large force about `LONGEST` long."""
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


def _same_component(one: Recorded, two: Recorded) -> bool:
    """Whether two results have one femoral component in one place, within a micrometre."""
    return all(_same_mesh(one.mesh(name), two.mesh(name)) for name in ("femur", "surface"))


def _same_mesh(a: Mesh | None, b: Mesh | None) -> bool:
    if a is None or b is None:
        return a is b
    return a[0].shape == b[0].shape and bool(np.allclose(a[0], b[0], atol=1e-6, rtol=0))


def _same_motion(one: Recorded, two: Recorded) -> bool:
    """Whether two results' tibias move so nearly alike that one of them is enough to look at."""
    if one.tibia.shape != two.tibia.shape:
        return False
    turned = one.tibia[:, :3, :3] - two.tibia[:, :3, :3]
    return bool(np.abs(turned).max() < ALIKE / 100 and np.abs(one.tibia - two.tibia)[:, :3, 3].max() < ALIKE)
