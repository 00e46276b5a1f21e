"""Export of a film of the knee, GIF or MP4: a headless browser renders the viewer's page frame by frame."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError, MissingExtraError
from pftwin.base.output import check_place, written_whole
from pftwin.results.viewer.bones import BONE, HOT

if TYPE_CHECKING:
    from k3d.plot import Plot
    from PIL.Image import Image

SUFFIXES = (".gif", ".mp4")
RATE = 20  # frames per second: the frame time is a whole number of a GIF's hundredths of a second
COLOURS = 256  # largest palette of a GIF
MOST = 2000  # largest number of frames
QUALITY = 7  # of an .mp4, 0 to 10: small files without visible loss
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # WebGL without a graphics card
_VIEWER = "document.querySelector('.pftwin').viewer"
_DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
_PATIENCE = 120_000  # timeout for loading the page and for a frame [ms]


def write_film(
    plot: Plot,
    path: str | os.PathLike[str],
    *,
    camera: str = "anterior",
    speed: float = 1.0,
    see_through: bool = False,
    size: tuple[int, int] = (720, 600),
    progress: Callable[[int, int], None] = lambda done, whole: None,
) -> None:
    """Writes a film of a plot made by `pftwin.viewer.view`.

    Args:
        plot: plot with controls, as returned by `pftwin.viewer.view`.
        path: output file: .gif, which all browsers and slides show, or .mp4, which is smaller.
        camera: "anterior", "lateral", "medial" or "skyline".
        speed: playback speed; 0.5 plays at half speed.
        see_through: make the patella transparent to show the contact behind it.
        size: width and height [px], even numbers.
        progress: called with the number of frames done and the total.

    Raises:
        MissingExtraError: the extra `film` is not installed.
        InputError: unsupported suffix, unknown camera, invalid speed, too many frames, or no working browser.
        OutputError: the path is not writable.
    """
    from pftwin.results.viewer.page import page

    target = check_film(path, speed)
    write = _write_gif if target.suffix.lower() == ".gif" else _write_mp4
    begin, end = plot.get_time_series_range()
    times = _times(begin, end, speed)
    with tempfile.TemporaryDirectory() as folder, written_whole(target) as whole:
        html = Path(folder) / "page.html"
        html.write_text(page(plot), encoding="utf-8")
        with _page(html, size) as shown:
            shown.evaluate(f"clear => {_VIEWER}.seeThrough(clear)", see_through)
            write(_pictures(shown, camera, times, size, progress), whole, size)


def check_film(path: str | os.PathLike[str], speed: float) -> Path:
    """Checks path, speed and installed packages before anything is drawn; raises as `write_film` does."""
    target = check_place(path)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError(f"found {target.suffix!r}", where=str(path), expected=" or ".join(SUFFIXES))
    if not 0 < speed < np.inf:
        raise InputError(f"found {speed!r}", where="speed", expected="a positive number")
    for package in ("playwright", *(["imageio_ffmpeg"] if target.suffix.lower() == ".mp4" else [])):
        if find_spec(package) is None:
            raise MissingExtraError(package, extra="film", feature="a film of the knee")
    return target


def _pictures(
    shown: Any, camera: str, times: Floats, size: tuple[int, int], progress: Callable[[int, int], None]
) -> Iterator[Image]:
    from PIL import Image

    cameras = shown.evaluate(f"Object.keys({_VIEWER}.control.views)")
    if camera not in cameras:
        raise InputError(f"found {camera!r}", where="camera", expected=f"one of: {', '.join(cameras)}")
    shown.evaluate(f"name => {_VIEWER}.look(name)", camera)
    for k, time in enumerate(times):
        shown.evaluate(f"time => {_VIEWER}.show(time)", float(time))
        shown.wait_for_function(f"{_VIEWER}.drawn()", timeout=_PATIENCE)
        shown.evaluate(_DRAWN)
        clip = {"x": 0, "y": 0, "width": size[0], "height": size[1]}
        yield Image.open(io.BytesIO(shown.screenshot(clip=clip, timeout=_PATIENCE))).convert("RGB")
        progress(k + 1, len(times))


def _times(begin: float, end: float, speed: float) -> Floats:
    """Simulation times of the frames [s]."""
    count = 1 + int((end - begin) / speed * RATE)
    if count > MOST:
        raise InputError(
            f"{count} pictures of {end - begin:.3g} s at {speed:g} x speed",
            where="speed",
            expected=f"{MOST} pictures at most",
            remedy=f"a speed of {(end - begin) * RATE / MOST:.2g} or more",
        )
    return begin + speed / RATE * np.arange(count, dtype=np.float64)


@contextmanager
def _page(html: Path, size: tuple[int, int]) -> Iterator[Any]:
    """Opens the page in a headless browser, with the control bar below the captured area."""
    from playwright.sync_api import Error, sync_playwright

    own = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=own, args=list(_FLAGS))
        except Error as error:
            raise InputError(
                f"no browser starts to draw the film: {str(error).splitlines()[0]}",
                where=own or "chromium",
                remedy="playwright install chromium",
            ) from error
        try:
            shown = browser.new_context(viewport={"width": size[0], "height": size[1]}, offline=True).new_page()
            shown.goto(html.as_uri())
            shown.wait_for_function("document.querySelector('.pftwin')?.viewer !== undefined", timeout=_PATIENCE)
            bar = int(shown.evaluate("document.querySelector('.pftwin').offsetHeight"))
            shown.set_viewport_size({"width": size[0], "height": size[1] + bar})
            yield shown
        except Error as error:
            raise InputError(
                f"the browser did not draw the film: {str(error).splitlines()[0]}", where=own or "chromium"
            ) from error
        finally:
            browser.close()


def _write_gif(pictures: Iterator[Image], path: Path, size: tuple[int, int]) -> None:
    from PIL.Image import Dither, Quantize

    first = next(pictures)
    palette = _with_scale(first).quantize(COLOURS, method=Quantize.MEDIANCUT, dither=Dither.NONE)
    frames = [p.quantize(palette=palette, dither=Dither.NONE) for p in (first, *pictures)]
    frames[0].save(
        path, format="GIF", save_all=True, append_images=frames[1:], duration=1000 // RATE, loop=0, optimize=True
    )


def _with_scale(picture: Image) -> Image:
    """Appends the contact colours to the first frame, so that the palette also suits later frames."""
    from PIL import Image, ImageColor

    codes = np.array([ImageColor.getrgb(code) for code in (BONE, *(code for _, code in HOT))], dtype=float)
    at = np.linspace(0, len(codes) - 1, picture.width)
    scale = np.stack([np.interp(at, np.arange(len(codes)), codes[:, k]) for k in range(3)], axis=1)
    rows = np.broadcast_to(scale.astype(np.uint8), (picture.height // 16, *scale.shape))
    return Image.fromarray(np.concatenate([np.asarray(picture), rows]))


def _write_mp4(pictures: Iterator[Image], path: Path, size: tuple[int, int]) -> None:
    from imageio_ffmpeg import write_frames

    writer = write_frames(str(path), size, fps=RATE, quality=QUALITY, macro_block_size=2, output_params=["-f", "mp4"])
    writer.send(None)
    try:
        for picture in pictures:
            writer.send(np.asarray(picture))
    finally:
        writer.close()
