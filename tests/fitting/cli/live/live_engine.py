"""An engine of the small knee for tests: two contacts, one that is refused, and one that fails."""

from __future__ import annotations

import equinox as eqx
from small_scene import polynomial, small_scene

from fitting.cli.live.engine import Engine
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


def live_engine() -> Engine:
    """The first contact of it is prepared."""
    engine = Engine(load, CONTACTS)
    engine.prepare("groove")
    return engine
