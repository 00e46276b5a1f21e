"""The parts that a scene can do without: its effects, and the friction of a contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pftwin.effects.base import Instant, Load
from pftwin.effects.friction import WithFriction
from pftwin.scene import Scene

Memories = tuple[Any, ...]


@dataclass(frozen=True)
class Part:
    """An effect, or the friction of one."""

    name: str
    kind: str  # the class that computes it
    index: int  # the effect's place
    without: Scene  # the scene that does without it
    forgetting: Callable[[Memories], Memories]  # that scene's memories from the whole scene's
    of: str | None = None  # the effect that it belongs to


def parts(scene: Scene) -> list[Part]:
    """All parts, an effect before its friction."""
    found = []
    for i, effect in enumerate(scene.effects):
        less = scene.without(effect.name)
        found.append(Part(effect.name, type(effect).__name__, i, less, lambda m, i=i: (*m[:i], *m[i + 1 :])))
        if isinstance(effect, WithFriction):
            smooth = scene.with_effect(effect.alone())
            found.append(
                Part(
                    f"{effect.name}: friction",
                    "Friction",
                    i,
                    smooth,
                    lambda m, i=i: (*m[:i], m[i].contact, *m[i + 1 :]),
                    of=effect.name,
                )
            )
    return found


def load_of(part: Part, effect: Any, now: Instant, memory: Any) -> list[tuple[float, Load]]:
    """The part's load as a sum of loads with their signs."""
    whole = effect.load(now, memory)[0]
    if part.of is None:
        return [(1.0, whole)]
    return [(1.0, whole), (-1.0, effect.alone().load(now, memory.contact)[0])]
