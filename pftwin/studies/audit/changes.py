"""How far a variant's run is from the scene's own: path, angles, forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pftwin.dynamics.status import Status
from pftwin.result import Result
from pftwin.rotations import patellar_angles
from pftwin.scene import Scene
from pftwin.spatial import Quaternion

LOST = 0.1  # [m] from its own path: no patella goes so far

Floats = NDArray[np.float64]


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
    point = np.asarray(scene.tracked_point().array(), dtype=np.float64)
    apart = np.linalg.norm(_path(result, point) - _path(own, point), axis=1)
    turned = [
        _rms(np.angle(np.exp(1j * (a - b)))) for a, b in zip(_angles(result), _angles(own), strict=True)
    ]  # fmt: skip
    contact = None
    if own.contact is not None and "force" in result.effects.get(own.contact, {}):
        contact = result.effects[own.contact]["force"] - own.effects[own.contact]["force"]
    tensions = {
        name: _sum(result.effects[name]["tension"]) - _sum(report["tension"])
        for name, report in own.effects.items()
        if "tension" in report and "tension" in result.effects.get(name, {})
    }
    most = max(tensions, key=lambda name: _rms(tensions[name]), default=None)
    pull = None if most is None else tensions[most]
    return Changes(
        center_rms=_rms(apart),
        center_max=float(apart.max()),
        flexion=turned[0],
        rotation=turned[1],
        tilt=turned[2],
        contact_rms=None if contact is None else _rms(contact),
        contact_max=None if contact is None else float(np.abs(contact).max()),
        tension_rms=None if pull is None else _rms(pull),
        tension_max=None if pull is None else float(np.abs(pull).max()),
        tension_of=most,
    )


def _path(result: Result, point: Floats) -> Floats:
    """Of a point of the patella, in the femur (n, 3): the same one in every variant, whatever it tracks itself."""
    turn = Quaternion(*result.quaternion.T).rotation()
    axes = [np.stack([np.asarray(c) for c in (a.x, a.y, a.z)], axis=1) for a in (turn.ex, turn.ey, turn.ez)]
    return result.position + sum(p * a for p, a in zip(point, axes, strict=True))


def _angles(result: Result) -> tuple[Floats, Floats, Floats]:
    found = patellar_angles(Quaternion(*result.quaternion.T))
    return np.asarray(found.flexion), np.asarray(found.rotation), np.asarray(found.tilt)


def _sum(tension: Floats) -> Floats:
    """Over a group's elements."""
    return tension.reshape(tension.shape[0], -1).sum(axis=1)


def _rms(a: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(a))))
