"""From values of the knobs to a motion: simulated whole, by a program that is compiled once for each contact."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from fitting.cli.live.answer import ShownMotion
from fitting.cli.live.knobs import neutral, turned, usable
from fitting.cli.live.still import Still
from pftwin.base.errors import InputError
from pftwin.dynamics.simulate import prepare_relaxation, simulate
from pftwin.model.scene import Scene

UNTREATED, TREATED = "untreated", "treated"


@dataclass(frozen=True, eq=False)
class LiveModel:
    """A scene with one contact, ready to be simulated at once."""

    contact: str
    scene: Scene
    still: Still
    before: ShownMotion  # untreated
    preparation: float  # that it took to compile, or to load what was compiled before [s]


class Engine:
    """Simulates a scene after treatments, with one of several contacts.

    Safe to be used by several threads. What `run` gives is what `pftwin.simulate` gives of the treated scene.
    """

    def __init__(self, load: Callable[[str], Scene], contacts: tuple[str, ...]) -> None:
        """For scenes of these contacts; the first one's is loaded now.

        Args:
            load: the scene with the contact of that name; raises InputError where there is none.
            contacts: the names.

        Raises:
            InputError: what the first scene has against it.
        """
        self._load, self.contacts = load, contacts
        self._models: dict[str, LiveModel] = {}
        self._preparing = threading.Lock()  # two threads cannot trace at once
        self._first = load(contacts[0])
        self.knobs, self.missing = usable(self._first)

    def ready(self, contact: str) -> bool:
        """Whether nothing has to be compiled for this contact any more."""
        return contact in self._models

    def model(self, contact: str) -> LiveModel:
        """What was prepared."""
        return self._models[contact]

    def prepare(self, contact: str) -> LiveModel:
        """Compiles for a contact, unless that was done; takes seconds.

        Raises:
            InputError: no such contact, or what the scene has against it, also that it cannot be simulated untreated.
        """
        with self._preparing:
            if contact in self._models:
                return self._models[contact]
            if contact not in self.contacts:
                shown = repr(contact) if len(contact) < 40 else f"{contact[:37]!r}..."
                raise InputError(f"found {shown}", where="contact", expected=f"one of: {', '.join(self.contacts)}")
            began = time.perf_counter()
            scene = self._first if contact == self.contacts[0] else self._load(contact)
            rest, still = turned(scene, self.knobs, neutral(self.knobs)), Still(scene)
            _simulated(rest, UNTREATED, still)  # compiles, the small programs of what is shown too
            prepare_relaxation(rest)
            before = _simulated(rest, UNTREATED, still)
            before.refuse_if_lost()
            self._models[contact] = LiveModel(contact, scene, still, before, time.perf_counter() - began)
            return self._models[contact]

    def run(self, contact: str, values: Mapping[str, float]) -> ShownMotion:
        """The whole motion with these values of the knobs and a contact that is ready.

        Raises:
            InputError: a value that is none, a treated scene that is none (a slack length below zero), or a motion that
                is not to be shown: without an equilibrium to start from, or lost.
        """
        model = self._models[contact]
        answer = _simulated(turned(model.scene, self.knobs, values), TREATED, model.still)
        answer.refuse_if_lost(unlike=model.before)
        return answer


def _simulated(scene: Scene, name: str, still: Still) -> ShownMotion:
    """With the integrator and the step that every command has if it is not told others."""
    began = time.perf_counter()
    answer = ShownMotion.of(simulate(scene), name, still.geometry(scene))
    return replace(answer, seconds=time.perf_counter() - began)
