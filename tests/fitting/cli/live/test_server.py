"""Pages without a browser: what sliders do, nonsense, several clients, contacts, and what a client leaves behind."""

from __future__ import annotations

import gc
import socket
import sys
import threading
import time
import weakref

import numpy as np
import pytest
from live_engine import live_engine, turned
from made_estimates import made_estimate
from scipy.spatial.transform import Rotation
from small_scene import small_scene

import pftwin
from fitting.cli.live.words import PACE_COUNT
from pftwin.base.errors import MissingExtraError

pytest.importorskip("viser")
from page_client import PageClient
from websockets.exceptions import InvalidStatus

from fitting.cli.live.server import LiveServer

MEDIALISE = "medialisation [mm]"


@pytest.fixture(scope="module")
def server():
    made = LiveServer(live_engine(), port=0)
    yield made
    made.stop()


@pytest.fixture
def client(server):
    wait_until_disconnected(server)
    with PageClient(server.address) as made:
        made.wait_for("Dislocation: no")
        until(lambda: server.sessions)
        yield made


def wait_until_disconnected(server) -> None:
    """Until the clients of former tests have left."""
    until(lambda: not server.sessions)


def until(true, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def drawn_for(session, **values) -> None:
    """Until what is drawn is the motion of these values."""
    result = pftwin.simulate(turned(small_scene(), **values))
    until(lambda: np.array_equal(session._after.recorded.data["patella_position"].values, result.position))


def test_a_slider_simulates_anew_and_the_page_tells_numbers_and_times(client, server):
    (session,) = server.sessions
    assert "none yet" in client.text()
    assert "treated" not in client.text().replace("compare with untreated", "")  # nothing is set yet
    client.move(MEDIALISE, 8.0)
    drawn_for(session, medialisation=8.0)
    client.wait_for("slider to new motion: <b>", "of the last 1: median")
    text = client.text()
    for words in ("Whole motion", "as set", "tilt [°]", "no treatment should be decided by it alone"):
        assert words in text
    place = client.nodes["/treated/tibia/patellar_tendon"]["position"]
    client.move(MEDIALISE, 10.0)
    client.wait_for("of the last 2: median")
    assert client.nodes["/treated/tibia/patellar_tendon"]["position"][1] == pytest.approx(place[1] - 2.0, abs=1e-3)


def test_a_fast_drag_does_not_queue_up_and_ends_where_it_ended(client, server):
    (session,) = server.sessions
    for k in range(200):
        client.move(MEDIALISE, 0.1 * k)
    drawn_for(session, medialisation=0.1 * 199)
    client.wait_for("of the last")  # noted after the drawing
    assert 1 <= len(session.motions) < PACE_COUNT == session.motions.maxlen == session.drawings.maxlen


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("text", "could not convert string to float"),
        (None, "malformed message: TypeError"),
        ([1.0], "malformed message: TypeError"),
        (float("nan"), "medialisation [mm]: found nan; expected: -20 to 30 mm"),
        (float("-inf"), "medialisation [mm]: found -inf"),
        (4000.0, "medialisation [mm]: found 4000 mm; expected: -20 to 30 mm"),
    ],
)
def test_nonsense_is_said_in_words_and_the_last_drawing_stays(client, server, capfd, value, words):
    (session,) = server.sessions
    client.move(MEDIALISE, 3.0)
    client.wait_for("of the last 1: median")
    last = session._after
    client.move(MEDIALISE, value)
    client.wait_for("Not drawn", words, "still show the last values that worked")
    assert session._after is last
    client.move(MEDIALISE, 4.0)
    drawn_for(session, medialisation=4.0)
    client.wait_for("Dislocation: no")
    assert "Traceback" not in capfd.readouterr().err


def test_a_slider_that_was_out_of_range_goes_back(client):
    client.move(MEDIALISE, 3.0)
    client.wait_for("of the last 1: median")
    client.move(MEDIALISE, 4000.0)
    client.wait(lambda c: c.elements[c.uuid(MEDIALISE)]["value"] == 3.0)


@pytest.mark.parametrize("message", [b"\x00garbage", {"type": "NoSuchMessage"}, {"type": "GuiUpdateMessage"}, {}])
def test_messages_that_are_none_end_that_page_alone(server, capfd, message):
    wait_until_disconnected(server)
    with PageClient(server.address) as other:
        other.wait_for("Dislocation: no")
        with PageClient(server.address) as mad:
            mad.wait_for("Dislocation: no")
            mad.send(message)
            until(lambda: len(server.sessions) == 1)
        other.move(MEDIALISE, 2.0)
        other.wait_for("of the last 1: median")
    assert "Traceback" not in capfd.readouterr().err


def test_nobody_opens_a_way_to_the_public_internet(client, monkeypatch):
    import viser

    asked = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *a, **k: asked.append(1))
    client.send({"type": "ShareUrlRequest"})
    client.listen(0.5)
    assert asked == []


@pytest.mark.parametrize("origin", ["https://evil.example", "http://localhost:1", "null"])
def test_a_page_of_another_site_is_refused(server, capfd, origin):
    wait_until_disconnected(server)
    with pytest.raises(InvalidStatus) as refused:
        PageClient(server.address, origin=origin)
    assert refused.value.response.status_code == 403
    assert f"a page of another origin was refused: {origin}" in capfd.readouterr().err
    assert not server.sessions


def test_its_own_page_is_let_in(server):
    wait_until_disconnected(server)
    with PageClient(server.address, origin=server.address) as own:
        own.wait_for("Dislocation: no")


def test_two_pages_are_independent(client, server):
    with PageClient(server.address) as second:
        second.wait_for("Dislocation: no")
        until(lambda: len(server.sessions) == 2)
        one, two = sorted(server.sessions, key=lambda s: s._client.client_id)
        client.move(MEDIALISE, 8.0)
        second.move("distalisation [mm]", 5.0)
        drawn_for(one, medialisation=8.0)
        drawn_for(two, distalisation=5.0)
        second.listen(0.3)
        assert second.value(MEDIALISE) == 0.0


def test_the_untreated_motion_is_shown_only_when_it_is_asked_for(client, server):
    """In the curves, the numbers at a time, those of the whole motion, and the legend."""
    (session,) = server.sessions

    def lines() -> list[int]:
        return [label(e).count("untreated") for e in client.elements.values() if "series" in e]

    def label(element) -> list[str]:
        return [line["label"] for line in element["series"]]

    client.move(MEDIALISE, 8.0)
    drawn_for(session, medialisation=8.0)
    client.wait_for("of the last 1: median")
    assert "untreated" not in client.text()
    assert lines() == [0, 0, 0]
    client.move("compare with untreated", True)
    client.wait(lambda c: c.text().count("untreated") == 3)
    client.wait(lambda _: lines() == [1, 1, 1])
    client.move("compare with untreated", False)
    client.wait(lambda c: "untreated" not in c.text())
    client.wait(lambda _: lines() == [0, 0, 0])


def test_curves_are_drawn_against_flexion_when_it_is_asked_for(client, server):
    charts = [e for e in client.elements.values() if "series" in e]
    assert [c["series"][0]["label"] for c in charts] == 3 * ["time [s]"]
    client.move("against knee flexion", True)
    client.wait(lambda _: [c["series"][0]["label"] for c in charts] == 3 * ["knee flexion [°]"])
    (session,) = server.sessions
    flexion = session._page._curves._drawn["tilt"][0].data[0]
    assert (np.diff(flexion) > 0).all()
    assert flexion[[0, -1]] == pytest.approx([45, 55], abs=0.1)  # of the small knee, which bends and straightens
    assert [line["dash"] for line in charts[0]["series"][1:-1]] == [[], [9.0, 5.0]]  # solid, dashed


def test_sliders_are_those_that_act_on_the_scene(client):
    shown = {label for e in client.elements.values() if e.get("visible") and (label := e.get("label"))}
    assert {"Tibial tuberosity", "Button", "Femoral component turned", "external rotation [deg]"} < shown
    assert not {"Trochlear groove", "Lateral strands", "deepening [mm]", "release [%]"} & shown
    assert "no tendon or strands named &#39;mpfl&#39;" in client.text()


def test_a_turned_component_is_drawn(client, server):
    (session,) = server.sessions
    until(lambda: session._page._bones._component is not None)
    rest = session._page._bones._component
    client.move("external rotation [deg]", 5.0)
    until(lambda: np.abs(session._page._bones._component - rest).max() > 1e-3)
    axis, turn = np.array([1.0, 0.0, 0.0]), -np.radians(5)  # about x proximal; the front, z, turns laterally: to y
    about = Rotation.from_rotvec(turn * axis)
    np.testing.assert_allclose(session._page._bones._component, about.apply(rest), atol=1e-7)
    client.move("Reset", True)
    until(lambda: np.array_equal(session._page._bones._component, rest))


def test_bands_of_an_estimate_come_when_the_slider_rests_and_go_at_the_next_move():
    """Their draws differ in one spring alone, so that the ends are those of the draws' own motions."""
    found = made_estimate({"K1": (156.0, 5.0)})
    server = LiveServer(live_engine(found), port=0)

    def bands(client) -> list[int]:
        return [len(e["bands"]) for e in client.elements.values() if "series" in e]

    try:
        with PageClient(server.address) as client:
            client.wait_for("Bands: the middle 90 % of 24 draws from the estimate. 0 dislocate.")
            client.wait(lambda c: bands(c) == [1, 1, 1])
            (session,) = server.sessions
            low, high = session._page._band.ends["tilt"]
            scenes = [turned(found.apply(small_scene(), theta)) for theta in found.samples(24)]
            tilts = [np.degrees(pftwin.simulate(scene).angles.tilt) for scene in scenes]
            np.testing.assert_allclose([low, high], np.percentile(tilts, [5, 95], axis=0), atol=1e-9)
            client.move(MEDIALISE, 8.0)
            client.wait(lambda c: bands(c) == [0, 0, 0])
            client.wait(lambda c: bands(c) == [1, 1, 1])
    finally:
        server.stop()


def test_reset_time_play_and_comparison(client, server):
    (session,) = server.sessions
    client.move(MEDIALISE, 8.0)
    drawn_for(session, medialisation=8.0)
    client.move("Reset", True)
    drawn_for(session)
    client.wait(lambda c: c.value(MEDIALISE) == 0.0)
    client.move("time [s]", 0.2)
    client.wait_for("<b>0.20 s</b>")
    client.move("time [s]", float("nan"))
    client.wait_for("no time nan in the motion, which goes from 0 to 0.4 s")
    client.move("compare with untreated", True)
    client.wait(lambda c: c.nodes["/untreated"]["visible"])
    client.move("Play", True)
    client.wait(lambda c: any(e.get("label") == "Pause" for e in c.elements.values()))
    place = client.nodes["/treated/patella"]["position"]
    client.wait(lambda c: c.nodes["/treated/patella"]["position"] != place)
    client.move("Pause", True)
    client.wait(lambda c: any(e.get("label") == "Play" for e in c.elements.values()))


@pytest.mark.slow
def test_another_contact_is_prepared_while_the_page_goes_on(client, server):
    (session,) = server.sessions
    client.move("contact", "cubic")
    client.wait_for("Preparing contact cubic", "the page and its sliders use groove")
    client.move(MEDIALISE, 5.0)
    client.wait_for("of the last 1: median")
    client.wait(lambda c: "Preparing" not in c.text(), 300.0)
    until(lambda: session._contact == "cubic")
    assert server._engine.ready("cubic")


@pytest.mark.parametrize(
    ("contact", "words"),
    [
        ("absent", "no mesh to fit it to"),
        ("broken", "an error in the program, ZeroDivisionError: see the terminal"),
        ("no such", "no contact"),
    ],
)
def test_a_contact_that_there_is_not_is_said_and_the_one_before_stays(client, server, contact, words):
    (session,) = server.sessions
    client.move("contact", contact)
    client.wait_for(words)
    client.wait(lambda c: c.value("contact") == "groove")
    client.move(MEDIALISE, 5.0)
    drawn_for(session, medialisation=5.0)


def test_a_client_that_leaves_frees_its_things(server):
    wait_until_disconnected(server)
    with PageClient(server.address) as client:
        client.wait_for("Dislocation: no")
        client.move("Play", True)
        client.wait(lambda c: any(e.get("label") == "Pause" for e in c.elements.values()))
        until(lambda: server.sessions)
        session = weakref.ref(server.sessions[0])
    wait_until_disconnected(server)
    until(lambda: "player" not in [t.name for t in threading.enumerate()])

    def freed() -> bool:
        gc.collect()
        return session() is None

    until(freed)


def test_nothing_is_written_to_a_client_who_has_left(server, monkeypatch):
    wait_until_disconnected(server)
    with PageClient(server.address) as client:
        client.wait_for("Dislocation: no")
        until(lambda: server.sessions)
        (session,) = server.sessions
    wait_until_disconnected(server)
    asked = []
    monkeypatch.setattr(session._page, "redraw", lambda: asked.append(1))
    monkeypatch.setattr(session._page, "frame", asked.append)
    session.redraw()
    session.pause()
    assert not asked


def test_a_port_that_is_taken_is_no_mistake(server):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        other = LiveServer(server._engine, port=port)
        try:
            assert other.port != port
            with PageClient(other.address) as client:
                client.wait_for("Dislocation: no")
        finally:
            other.stop()


def test_without_viser_the_extra_is_named(server, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"pftwin\[app\]"):
        LiveServer(server._engine)
