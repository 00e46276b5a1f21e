"""A change of a scene whose worth is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pftwin.dynamics.integrator import Integrator
from pftwin.model.scene import Scene

Kind = Literal["left out", "put in", "changed", "yardstick"]
KINDS: tuple[Kind, ...] = get_args(Kind)  # in the order of tables


@dataclass(frozen=True)
class Variant:
    """What is changed, and the scene with the change."""

    name: str
    kind: Kind
    sentence: str
    scene: Scene
    alike: bool = False  # whether only numbers differ, so that it is run side by side with its like
    integrator: Integrator | None = None  # in the place of the scene's
    refine: int = 1  # how many steps there are for each one


@dataclass(frozen=True)
class NotApplicable:
    """What cannot be left out or put in here, and why."""

    name: str
    kind: Kind
    reason: str
