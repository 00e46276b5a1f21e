"""Data for the page of a twin in a file, besides its programs: sliders, frames, flags and groove."""

from __future__ import annotations

from typing import Any

import numpy as np

from fitting.cli.live.knobs import Knob
from fitting.prediction.predicting import untrusted_start
from pftwin.base.rotations import tibiofemoral_angles
from pftwin.dynamics.status import Status
from pftwin.model.motion_on_host import tibia_orientation
from pftwin.model.scene import Scene
from pftwin.results.tracking import DISLOCATED, RE_ENGAGED, groove_line
from pftwin.results.verdict import IN_ORDER, most_frames


def facts(scene: Scene, knobs: tuple[Knob, ...], missing: dict[str, str]) -> dict[str, Any]:
    """Data of a scene for the page, as values for JSON; `missing` gives reasons for missing sliders, by group.

    `reasons` are why the untreated scene is INVALID; they hold for all values of the sliders.
    """
    motion, contact = scene.motion, scene.contact
    surface: Any = None if contact is None else contact.groove_surface()
    shown = ("name", "label", "group", "unit", "least", "most", "step", "neutral", "hint")
    return {
        "name": scene.name,
        "synthetic": scene.synthetic,
        "frames": motion.n_frames,
        "times": np.asarray(motion.times, float).tolist(),
        "flexion": np.degrees(np.asarray(tibiofemoral_angles(tibia_orientation(motion)).flexion)).tolist(),
        "knobs": [{name: getattr(k, name) for name in shown} for k in knobs],
        "missing": missing,
        "reasons": list(untrusted_start(scene)),
        "hasContact": contact is not None,
        "groove": None if surface is None else _groove(surface),
        "dislocated": DISLOCATED,
        "reEngaged": RE_ENGAGED,
        "stepTooLong": int(Status.STEP_TOO_LONG),
        "flags": [
            {
                "bit": int(flag),
                "words": flag.describe(),
                "most": most_frames(flag, motion.n_frames),
                "everywhere": flag is Status.START_NOT_IN_EQUILIBRIUM,
            }
            for flag in IN_ORDER
        ],
    }


def _groove(surface: Any) -> dict[str, list[float]]:
    """Bottom line of the groove in chart coordinates; the surface's centre without a groove, as in `groove_offset`."""
    line = groove_line(surface)
    if line is None:
        return {"u": [0.0], "v": [float(getattr(surface, "center", (0.0, 0.0))[1])]}
    return {"u": line.u.tolist(), "v": line.v.tolist()}
