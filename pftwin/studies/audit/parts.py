"""The parts that a scene can do without: its effects, and what of an effect has a load of its own (friction)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pftwin.model.effects.base import Change, Effect, Instant, Load
from pftwin.model.scene import Scene

Memories = tuple[Any, ...]


@dataclass(frozen=True)
class EffectPart:
    """An effect, or a part of one."""

    name: str
    kind: str  # what computes it
    index: int  # the effect's place
    without: Scene  # the scene that does without it
    forgetting: Callable[[Memories], Memories]  # that scene's memories from the whole scene's
    of: str | None = None  # the effect that it belongs to


def separable(effect: Effect) -> list[tuple[Change, Callable[[Any], Any]]]:
    """What of an effect has a load of its own, with the way from the whole's memory to the rest's."""
    return [(c, c.memory) for c in effect.simplifications() if c.memory is not None]


def parts(scene: Scene) -> list[EffectPart]:
    """All parts, an effect before its own."""
    found = []
    for i, effect in enumerate(scene.effects):
        less = scene.without(effect.name)
        found.append(EffectPart(effect.name, type(effect).__name__, i, less, lambda m, i=i: (*m[:i], *m[i + 1 :])))
        for c, rest in separable(effect):
            forgetting = lambda m, i=i, rest=rest: (*m[:i], rest(m[i]), *m[i + 1 :])  # noqa: E731
            name, kind = f"{effect.name}: {c.label}", c.label.capitalize()
            found.append(EffectPart(name, kind, i, scene.with_effect(c.effect), forgetting, of=effect.name))
    return found


def load_of(part: EffectPart, effect: Effect, now: Instant, memory: Any) -> list[tuple[float, Load]]:
    """The part's load as a sum of loads with their signs; `effect` is made ready by `recentred`."""
    loads = [(1.0, effect.load(now, memory)[0])]
    own = [(c, rest) for c, rest in separable(effect) if part.name == f"{part.of}: {c.label}"]
    return [*loads, *((-1.0, c.effect.load(now, rest(memory))[0]) for c, rest in own)]
