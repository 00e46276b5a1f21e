"""The live page of one client: sliders, buttons, curves, texts and the drawing; events go to its session."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from fitting.cli.live import words
from fitting.cli.live.curves import AGAINST, Curves, why_not_against_flexion
from fitting.cli.live.drawing import Bones, DrawnKnee
from fitting.cli.live.engine import Engine, LiveModel
from fitting.cli.live.knobs import GROUPS, KNOBS
from fitting.cli.live.motion import AS_SET, Band, DrawnMotion, ShownMotion
from fitting.cli.live.words import AFTER, BEFORE
from fitting.prediction.predicting import caveats
from pftwin.results.viewer.assembly import per_centimetre
from pftwin.results.viewer.framing import views
from pftwin.results.viewer.page import CONTINUED, legend, notes, readout

if TYPE_CHECKING:
    from viser import ClientHandle

    from fitting.cli.live.session import Session

GHOST = 0.45  # opacity of the untreated knee


class Page:
    """The page of one client; its session sets `state`, `pace`, `knobs`, `contacts`, `time`, `play`, `untreated`."""

    def __init__(self, client: ClientHandle, engine: Engine, model: LiveModel, session: Session) -> None:
        self._client, self._gui, self._session = client, client.gui, session
        self.newtons = per_centimetre([model.before.recorded])
        self._contact: str | None = None
        self._band: Band | None = None
        self._continued = False  # whether the extrapolated surface, which the legend explains, is drawn
        self._notes = [] if engine.estimate is None else caveats(engine.estimate, synthetic=False)
        self._before, self._after = model.before, model.before.named(AS_SET)
        self._bones = Bones(client.scene, model.before.recorded)
        self._treated = DrawnKnee(client.scene, "/treated", AFTER)
        self.untreated = DrawnKnee(client.scene, "/untreated", BEFORE, GHOST)
        self._gui.main_panel.dock_right()
        self._gui.set_panel_label("Treatment")
        self.state = self._gui.add_html("")
        self._folders: dict[str, Any] = {}
        self.knobs = self._add_sliders()
        self._add_model_controls(engine)
        self._add_views(model)
        self._legend = self._gui.add_html(self._legend_text())
        panel = self._gui.add_panel()
        with panel.add_tab("Motion"):
            self._add_time_controls(model)
            self._numbers = self._gui.add_html("")
            self._extremes = self._gui.add_html("")
            why = why_not_against_flexion(model.before)
            text, hint = "against knee flexion", why or AGAINST
            self._by_flexion = self._gui.add_checkbox(text, False, disabled=bool(why), hint=hint)
            self._on_input(self._by_flexion, self._session.redraw)
            self._curve_notes = self._gui.add_html("")
            self._curves = Curves(self._gui, model.before)
        with panel.add_tab("Times"):  # computing times, apart from the results
            self.pace = self._gui.add_html(words.pace_text((), (), 0.0))
        panel.dock_left()
        panel.set_width(400)

    def set_motion(self, model: LiveModel, after: ShownMotion) -> None:
        """Sets the motion of the table and the curves, which are redrawn at the next call of `number`."""
        if self._contact != model.contact:
            self._show_usable_sliders(model)
        self._before, self._after, self._band = model.before, after, None
        self._update_texts()

    def set_band(self, band: Band | None) -> None:
        """Sets the band of the current motion in the curves."""
        self._band = band
        self._update_texts()

    def draw(self, model: LiveModel, shown: DrawnMotion) -> None:
        """Draws another motion: the knee and its extrapolated surface."""
        if self._contact != model.contact:
            self._contact = model.contact
            self.untreated.set(DrawnMotion(model.before.recorded, self.newtons))
        self._shown = shown
        self._treated.set(shown)
        self._bones.set_component(shown.recorded)
        extrapolated = self._after.continued(shown.touched)
        self._bones.set_extrapolated(extrapolated)
        if self._continued != (extrapolated is not None):
            self._continued = not self._continued
            self._legend.content = self._legend_text()

    def frame(self, k: int) -> None:
        """Moves the drawing to a frame."""
        self._bones.frame(self._shown, k)
        self._treated.frame(k)
        if self._compared.value:
            self.untreated.frame(k)

    def show_numbers(self, k: int, at: float) -> None:
        """Shows the numbers at time `at` [s], frame `k`, and marks it in the curves."""
        motions, colours = self._shown_motions()
        self._numbers.content = words.with_margins(readout([m.recorded for m in motions], colours, at))
        self._curves.mark(k)

    def redraw(self) -> None:
        """Applies the checkboxes: shows or hides the untreated knee, its curves and its numbers, and sets the abscissa;
        curves and numbers of a time follow at the next call of `number`."""
        self.untreated.show(self._compared.value)
        self._legend.content = self._legend_text()
        self._update_texts()

    def _update_texts(self) -> None:
        shown = {"compared": self._compared.value, "against_flexion": self._by_flexion.value}
        self._curves.set(self._before, self._after, self._band, **shown)
        notes = [AGAINST] if self._by_flexion.value else []
        self._curve_notes.content = words.aside(*notes, *([] if self._band is None else [self._band.words]))
        self._extremes.content = words.whole_motion(*self._shown_motions())

    def _shown_motions(self) -> tuple[list[ShownMotion], list[str]]:
        """The displayed motions and their colours; the untreated one only if it is to be compared."""
        both = [self._before, self._after], [BEFORE, AFTER]
        return both if self._compared.value else (both[0][1:], both[1][1:])

    def _legend_text(self) -> str:
        motions, colours = self._shown_motions()
        pale = [CONTINUED] if self._continued else []
        lines = [*notes([self._before.recorded], self.newtons), *pale, *self._notes, words.NOT_FOR_PATIENTS]
        return words.with_margins(legend([m.recorded for m in motions], colours, lines))

    def _add_sliders(self) -> dict[str, Any]:
        """Adds a slider for every knob, in folders; `_show_usable_sliders` hides those that do not apply to a model."""
        found = {}
        for group in GROUPS:
            self._folders[group] = self._gui.add_folder(group, expand_by_default=group == GROUPS[0])
            with self._folders[group]:
                for k in (k for k in KNOBS if k.group == group):
                    numbers = (k.least, k.most, k.step, k.neutral)
                    found[k.name] = self._gui.add_slider(k.label, *numbers, hint=k.hint, marks=(k.neutral,))
                    self._on_input(found[k.name], partial(self._session.turn, k))
        self._missing = self._gui.add_folder("Cannot be changed here", expand_by_default=False)
        with self._missing:
            self._reasons = self._gui.add_html("")
        return found

    def _show_usable_sliders(self, model: LiveModel) -> None:
        """Shows the sliders that apply to a model, and the reasons why others are missing."""
        usable = {k.name for k in model.knobs.usable}
        for name, slider in self.knobs.items():
            slider.visible = name in usable
        for group, folder in self._folders.items():
            folder.visible = any(k.group == group and k.name in usable for k in KNOBS)
        self._missing.visible = bool(model.knobs.missing)
        self._reasons.content = "".join(words.state("doubt", g, why) for g, why in model.knobs.missing.items())

    def _on_input(self, element: Any, handler: Callable[[Any], None]) -> None:
        """Calls `handler` with every new value of an element that the client, not this program, has set."""

        @element.on_update
        async def _(event: Any) -> None:
            if event.client is not None:
                handler(element.value)

    def _add_model_controls(self, engine: Engine) -> None:
        with self._gui.add_folder("Model"):
            self.contacts = self._gui.add_dropdown("contact", engine.contacts, initial_value=engine.contacts[0])
            self._compared = self._gui.add_checkbox("compare with untreated", False)
            reset = self._gui.add_button("Reset")
        self.untreated.show(False)
        self._on_input(self.contacts, self._session.choose)
        self._on_input(self._compared, self._session.redraw)

        @reset.on_click
        async def _(_: Any) -> None:
            self._session.reset()

    def _add_time_controls(self, model: LiveModel) -> None:
        times = model.before.times
        begin, end = float(times[0]), float(times[-1])
        self.time = self._gui.add_slider("time [s]", begin, end, round(float(np.diff(times).min()), 4), begin)
        self.play = self._gui.add_button("Play")
        self._on_input(self.time, self._session.seek)

        @self.play.on_click
        async def _(_: Any) -> None:
            self._session.play_or_pause()

    def _add_views(self, model: LiveModel) -> None:
        found = views(model.before.recorded)
        buttons = self._gui.add_button_group("view", tuple(name.capitalize() for name in found))

        @buttons.on_click
        async def _(_: Any) -> None:
            numbers = found.get(str(buttons.value).lower())
            if numbers is not None:
                camera, place = self._client.camera, np.asarray(numbers)
                with self._client.atomic():
                    camera.position, camera.look_at, camera.up_direction = place[:3], place[3:6], place[6:]
