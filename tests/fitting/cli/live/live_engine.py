"""An engine of the small knee for tests: two contacts, one that is refused, and one that fails."""

from __future__ import annotations

import equinox as eqx
from small_scene import polynomial, small_scene

from fitting.cli.live.engine import Engine
from fitting.cli.live.knobs import Knobs, neutral
from fitting.estimate import Estimate
from pftwin.base.errors import InputError
from pftwin.model.scene import Scene

CONTACTS = ("groove", "cubic", "absent", "broken")


def load(name: str) -> Scene:
    scene = small_scene()
    if name == "absent":
        raise InputError("no mesh to fit it to", where="absent")
    if name == "broken":
        raise ZeroDivisionError("on purpose")
    if name == "groove":
        return scene
    k = 1 / (2 * 0.015)
    deeper = polynomial({(2, 0): -1 / (2 * 0.026), (0, 2): k, (0, 3): 0.0}, degree=3)
    return scene.with_effect(eqx.tree_at(lambda c: c.surface, scene.contact, deeper))


TRANSFER = "tibial_tuberosity_transfer"


def turned(scene: Scene, **values: float) -> Scene:
    """The scene after a transfer of its tuberosity, or with other knobs, by name with __ for the dot."""
    names = {k.replace("__", ".") if "__" in k else f"{TRANSFER}.{k}": v for k, v in values.items()}
    return Knobs.of(scene).scene_with({**neutral(), **names})


def live_engine(estimate: Estimate | None = None) -> Engine:
    """The first contact of it is prepared."""
    engine = Engine(load, CONTACTS, estimate)
    engine.prepare("groove")
    return engine
