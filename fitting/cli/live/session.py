"""The state of one live page: slider values, motion and drawing; pages share none of it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.live import words
from fitting.cli.live.engine import Engine, LiveModel
from fitting.cli.live.knobs import KNOBS, Knob, neutral
from fitting.cli.live.motion import AS_SET, DrawnMotion, ShownMotion
from fitting.cli.live.page import Page
from fitting.cli.live.threads import Player, Worker
from pftwin.base.errors import InputError

if TYPE_CHECKING:
    from viser import ClientHandle

_REST = 0.3  # wait after the last move of a slider before a band is computed [s]
_NUMBERS_EVERY = 0.1  # time between updates of numbers and marks while the motion plays [s]


class Session:
    """Connects the page of one client to the engine.

    Events arrive on the server's event loop, simulations run in the worker's thread, and frames are set by the player's
    thread: shared state is changed under a lock.
    """

    def __init__(
        self, client: ClientHandle, engine: Engine, simulating: Worker, preparing: Worker, drawing_bands: Worker
    ) -> None:
        self._client, self._engine = client, engine
        self._simulating, self._preparing, self._drawing_bands = simulating, preparing, drawing_bands
        self._requests = 0  # number of motions requested so far
        self._lock = threading.RLock()
        self._closed, self._numbers_shown = False, 0.0
        self._values = neutral()
        self._wanted = self._contact = engine.contacts[0]
        self.motions, self.drawings = deque[float](maxlen=words.PACE_COUNT), deque[float](maxlen=words.PACE_COUNT)
        model = engine.model(self._contact)
        self._after, self._now = model.before.named(AS_SET), float(model.before.times[0])
        with self._lock, client.atomic():
            self._page = Page(client, engine, model, self)
            self._player = Player(self._show_playing, self._now, float(model.before.times[-1]))
            self._show_motions(model, self._after)
            self._draw(model, DrawnMotion(model.before.recorded, self._page.newtons))
        self._request_band(self._contact, dict(self._values))

    def turn(self, knob: Knob, value: Any) -> None:
        """Takes the value of a slider that was moved."""
        began = time.perf_counter()
        try:
            self._values[knob.name] = knob.checked(value)
        except InputError as error:
            self.refuse(str(error))
            self._page.knobs[knob.name].value = self._values[knob.name]
            return
        self._request_motion(began)

    def reset(self) -> None:
        """Sets all sliders back to the untreated scene."""
        began = time.perf_counter()
        self._values = neutral()
        for knob in KNOBS:
            self._page.knobs[knob.name].value = knob.neutral
        self._request_motion(began)

    def choose(self, contact: Any) -> None:
        """Chooses another contact; until it is compiled, the page continues with the previous one."""
        began = time.perf_counter()
        if contact not in self._engine.contacts:
            self.refuse(f"no contact {str(contact)[:40]!r}")
            self._page.contacts.value = self._wanted
            return
        self._wanted = contact
        if self._engine.ready(contact):
            self._request_motion(began)
            return
        self._set_state(words.waiting(contact, self._contact))
        self._preparing.submit(self, lambda: self._prepare(contact))

    def seek(self, at: Any) -> None:
        """Pauses and goes to the time that the time slider was moved to [s]."""
        self.pause()
        begin, end = self._after.times[[0, -1]]
        if isinstance(at, int | float) and begin - 1e-3 <= at <= end + 1e-3:
            self._frame(float(at), numbers=True)
        else:
            self.refuse(f"no time {str(at)[:40]} in the motion, which goes from {begin:g} to {end:g} s")
            self._page.time.value = self._now

    def play_or_pause(self) -> None:
        """Plays the motion, or pauses it if it is playing."""
        if self._player.playing:
            self.pause()
        else:
            self._player.play(self._now)
            self._page.play.label = "Pause"

    def pause(self) -> None:
        """Pauses at the current frame."""
        self._player.pause()
        self._page.play.label = "Play"
        self._frame(self._now, numbers=True)

    def redraw(self, _: Any = None) -> None:
        """Shows or hides the untreated knee, its curves and its numbers, and draws curves over time or flexion."""
        with self._lock:
            if self._closed:
                return
            with self._client.atomic():
                self._page.redraw()
                self._frame(self._now, numbers=True)

    def refuse(self, why: str) -> None:
        """Shows why no new motion is drawn."""
        still = "The drawing and the curves still show the last values that worked."
        self._set_state(words.state("bad", f"Not drawn: {why}", still))

    def close(self) -> None:
        """Stops all work for the client, after it has disconnected."""
        with self._lock:
            self._closed = True
        self._player.pause()
        self._simulating.forget(self)
        self._preparing.forget(self)
        self._drawing_bands.forget(self)

    def _prepare(self, contact: str) -> None:
        """Compiles the model of a contact, in the preparing worker's thread."""
        try:
            self._engine.prepare(contact)
        except Exception as error:
            if self._wanted == contact:
                self._wanted = self._contact
                self._page.contacts.value = self._contact
                self._show_error(error)
            if not isinstance(error, InputError):
                raise
        else:
            if self._wanted == contact:
                self._request_motion(time.perf_counter())

    def _request_motion(self, began: float) -> None:
        """Queues a simulation, which uses the slider values at the time when it starts."""
        self._requests += 1
        self._simulating.submit(self, lambda: self._simulate(began))

    def _simulate(self, began: float) -> None:
        """In the worker's thread: simulates, sends texts and numbers, then the drawing, which takes longer."""
        contact, values = self._wanted if self._engine.ready(self._wanted) else self._contact, dict(self._values)
        try:
            model = self._engine.model(contact)
            after = self._engine.run(contact, values)
        except Exception as error:
            self._show_error(error)
            if not isinstance(error, InputError):
                raise
            return
        moved = time.perf_counter()
        with self._lock:
            if self._closed:
                return
            with self._client.atomic():
                self._show_motions(model, after)
            self._client.flush()
            shown = DrawnMotion(after.recorded, self._page.newtons)
            with self._client.atomic():
                self._draw(model, shown)
            self._client.flush()
            self.motions.append(moved - began)
            self.drawings.append(time.perf_counter() - began)
            self._page.pace.content = words.pace_text(self.motions, self.drawings, after.seconds)
            if self._wanted != contact:
                self._page.state.content = words.waiting(self._wanted, contact)
        self._request_band(contact, values)

    def _request_band(self, contact: str, values: dict[str, float]) -> None:
        """Queues the band of the current motion, if there is an estimate; the next move of a slider cancels it."""
        if self._engine.estimate is not None:
            after, asked = self._after, self._requests
            wanted = lambda: self._requests == asked and not self._closed  # noqa: E731
            self._drawing_bands.submit(self, lambda: self._simulate_band(contact, values, after, wanted))

    def _simulate_band(
        self, contact: str, values: dict[str, float], after: ShownMotion, wanted: Callable[[], bool]
    ) -> None:
        """In the bands' thread, after a pause: simulates draws, and draws their band."""
        time.sleep(_REST)
        band = self._engine.band(contact, values, after, wanted)
        with self._lock:
            if band is not None and wanted() and self._after is after:
                with self._client.atomic():
                    self._page.set_band(band)
                    self._frame(self._now, numbers=True)

    def _show_motions(self, model: LiveModel, after: ShownMotion) -> None:
        self._contact, self._after = model.contact, after
        self._page.set_motion(model, after)
        self._page.state.content = words.outcome(after)
        self._numbers_shown = time.perf_counter()
        self._page.show_numbers(self._nearest(self._now), self._now)

    def _draw(self, model: LiveModel, shown: DrawnMotion) -> None:
        self._page.draw(model, shown)
        self._frame(self._now, numbers=False)

    def _show_playing(self, at: float) -> None:
        now = time.perf_counter()
        self._frame(at, numbers=now - self._numbers_shown > _NUMBERS_EVERY, slider=True)

    def _frame(self, at: float, *, numbers: bool, slider: bool = False) -> None:
        with self._lock:
            if self._closed:
                return
            self._now = at
            k = self._nearest(at)
            with self._client.atomic():
                self._page.frame(k)
                if numbers:
                    self._numbers_shown = time.perf_counter()
                    self._page.show_numbers(k, at)
                if slider and numbers:
                    self._page.time.value = at

    def _nearest(self, at: float) -> int:
        """The displayed frame nearest to a time [s]."""
        return int(np.argmin(np.abs(self._after.times - at)))

    def _show_error(self, error: Exception) -> None:
        """Shows why a motion failed; for a bug in the program, refers to the terminal."""
        own = isinstance(error, InputError)
        self.refuse(str(error) if own else f"an error in the program, {type(error).__name__}: see the terminal")

    def _set_state(self, text: str) -> None:
        with self._lock:
            if not self._closed:
                self._page.state.content = text
