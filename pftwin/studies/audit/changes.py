"""How far a variant's run is from the scene's own: path, angles, forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pftwin.dynamics.status import Status
from pftwin.model.scene import Scene
from pftwin.results.result import Result
from pftwin.studies.runs import Floats, difference, rms

LOST = 0.1  # [m] from its own path: no patella goes so far


@dataclass(frozen=True)
class Changes:
    """Of a variant against the scene, over the frames."""

    center_rms: float  # of the tracked point [m]
    center_max: float  # [m]
    flexion: float  # rms [rad]
    rotation: float  # rms [rad]
    tilt: float  # rms [rad]
    contact_rms: float | None  # of the button's contact force [N]; None where either has none
    contact_max: float | None  # [N]
    tension_rms: float | None  # of the tension that changes most among those that both have [N]
    tension_max: float | None  # [N]
    tension_of: str | None  # whose that is


def lost(result: Result, own: Result) -> str | None:
    """Why a run gives no figures to compare; None where it does. `own` is the scene's run."""
    if not result.equilibrium.converged and own.equilibrium.converged:
        return "no equilibrium to start from"
    if Status.NOT_FINITE in result.status:
        return "does not stay finite"
    if np.linalg.norm(result.position - own.position, axis=1).max() > LOST:
        return "the patella flies off"
    return None


def changes(scene: Scene, result: Result, own: Result) -> Changes:
    """Of a run against the scene's own."""
    apart = difference(result, own, np.asarray(scene.tracked_point().array(), dtype=np.float64))
    tensions = {
        name: _sum(result.effects[name]["tension"]) - _sum(report["tension"])
        for name, report in own.effects.items()
        if "tension" in report and "tension" in result.effects.get(name, {})
    }
    most = max(tensions, key=lambda name: rms(tensions[name]), default=None)
    pull = None if most is None else tensions[most]
    return Changes(
        center_rms=rms(apart.center),
        center_max=float(apart.center.max()),
        flexion=rms(apart.flexion),
        rotation=rms(apart.rotation),
        tilt=rms(apart.tilt),
        contact_rms=None if apart.contact is None else rms(apart.contact),
        contact_max=None if apart.contact is None else float(np.abs(apart.contact).max()),
        tension_rms=None if pull is None else rms(pull),
        tension_max=None if pull is None else float(np.abs(pull).max()),
        tension_of=most,
    )


def _sum(tension: Floats) -> Floats:
    """Over a group's elements."""
    return tension.reshape(tension.shape[0], -1).sum(axis=1)
