"""`pftwin app`."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from fitting.cli.treat import EstimateOption, loaded_estimate
from pftwin.cli.scenes import CaseOption, SceneArgument, chosen_scene
from pftwin.cli.terminal import show, spinner, tell

if TYPE_CHECKING:
    from pftwin.model.scene import Scene


def app(
    scene: SceneArgument = None,
    *,
    case: CaseOption = None,
    contact: Annotated[str | None, Option(metavar="NAME", help="Initial contact; the page offers others.")] = None,
    estimate: EstimateOption = None,
    host: Annotated[
        str, Option(metavar="ADDRESS", help="Address to serve at; the default serves only this machine.")
    ] = "127.0.0.1",
    port: Annotated[int, Option(min=0, max=65535, help="Port; if in use, the next free one; 0: any.")] = 8080,
    origin: Annotated[
        list[str] | None,
        Option(metavar="URL", help="Also accept connections from pages of this origin; may be repeated."),
    ] = None,
    browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Set treatments with sliders in the browser: every move simulates the whole motion anew.

    With --estimate, the page shows the fitted knee, and curves have bands from draws of the estimate.

    Example: `pftwin app --case 2 --open`
    """
    began = time.perf_counter()
    from fitting.cli.live.access import check_address, checked_origins, loopback

    check_address(host, port)
    origins = checked_origins(origin or ())
    chosen = chosen_scene(scene, case, contact)
    from fitting.cli.live.engine import Engine
    from fitting.cli.live.server import LiveServer, viser

    viser()
    own = chosen.contact or "as in the file"

    def load(name: str) -> Scene:
        return chosen.scene if name == own else chosen_scene(scene, case, name).scene

    engine = Engine(load, contacts_of(case, chosen.contact), loaded_estimate(estimate))
    with spinner(f"compiling {chosen.scene.name}, half a minute the first time"):
        engine.prepare(own)
    server = LiveServer(engine, host, port, origins)
    try:
        _announce(server.address, host, time.perf_counter() - began, safe=loopback(host))
        if browser:
            typer.launch(server.address)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        show("ended")
    finally:
        server.stop()


def contacts_of(case: int | None, own: str | None) -> tuple[str, ...]:
    """Names of the contacts that the page offers, the scene's own first; `case` is the rig's, None for other scenes."""
    from pftwin.geometry.patch.fit import SPLINE
    from pftwin.rig.contacts import ON_MESHES

    smooth = ("P2", "P4", "P5", SPLINE)
    if own is None:
        return ("as in the file",)
    if case is not None:
        return tuple(dict.fromkeys((own, *smooth, *ON_MESHES)))
    fitted = own == SPLINE or re.fullmatch(r"P\d+", own)  # a file's mesh, which all patches can be fitted to
    return tuple(dict.fromkeys((own, *smooth))) if fitted else (own,)


def _announce(address: str, host: str, seconds: float, *, safe: bool) -> None:
    show(f"ready after {seconds:.1f} s: {address}  (Ctrl-C ends it)")
    if not safe:
        tell(
            f"warning: {host} can be reached from other machines, and anyone who reaches it can use this page: there is"
            " no password and no encryption. Without --host, the page is served only to this machine.",
            "yellow",
        )
