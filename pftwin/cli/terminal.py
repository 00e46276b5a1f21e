"""Shared functions of the commands: output of results, progress, and checks of output paths."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from pftwin.base import runtime
from pftwin.base.errors import InputError, OutputError
from pftwin.base.output import check_place, written_whole
from pftwin.base.sheet import Sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console


JsonOption = Annotated[
    str | None, Option("--json", metavar="FILE|-", help="Write the result as JSON to a file, or to stdout with -.")
]
AxesOption = Annotated[
    str,
    Option(
        "--axes",
        metavar="pftwin|isb",
        help="Axes of the tables (.csv, .sto); isb: x anterior, y proximal, z to the right.",
    ),
]
FIGURES = (".png", ".svg", ".pdf")
_COUNTS = 42  # characters of a line of progress that long labels leave for bar, counts and time left
_PERIOD = 1800.0  # the time left follows from the pace of so many seconds; a step of the work may take minutes


def err() -> Console:
    """Returns the console on stderr, for progress, warnings and errors."""
    from rich.console import Console

    return Console(stderr=True)


def tell(text: str, style: str | None = None) -> None:
    """Writes a line to stderr."""
    err().print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def show(*parts: Sheet | str, json: str | None = None, markdown: bool = False) -> None:
    """Prints tables with their notes, and lines, to stdout, or to stderr if JSON goes to stdout ("-").

    Empty lines are skipped. With `markdown`, tables are in Markdown.
    """
    from rich.console import Console

    console = Console(stderr=json == "-", soft_wrap=True)
    for part in parts:
        if isinstance(part, str):
            lines = [part] if part else []
        elif markdown:
            lines = [part.markdown()]
        else:
            console.print(*part.tables(console.width), sep="\n")
            lines = part.notes
        for line in lines:
            console.print(line, markup=False, highlight=False)


def present(facts: Any, *parts: Sheet | str, json: str | None, markdown: bool = False) -> None:
    """Reports the result of a command: its facts as JSON if requested, and tables and lines."""
    write_json(facts, json)
    show(*parts, json=json, markdown=markdown)


def written_line(paths: Sequence[Path | str | None]) -> str:
    """Returns the line that names the files written by a command, without None; empty if there are none."""
    there = [str(path) for path in paths if path is not None]
    return f"written: {', '.join(there)}" if there else ""


@contextmanager
def spinner(what: str) -> Iterator[None]:
    """Shows a spinner on stderr during the work inside; nothing if stderr is not a terminal."""
    with err().status(f"{what} ..."):
        yield


@contextmanager
def progress(what: str) -> Iterator[Callable[..., None]]:
    """Shows a progress bar on stderr with n of N and the time left; nothing if stderr is not a terminal.

    Yields `show(done, of, now=None, what=None)`; `now` replaces "n of N".
    """
    from rich.progress import BarColumn, Progress, Task, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class TimeLeft(TimeRemainingColumn):
        """The time left; nothing as long as it is not known."""

        def render(self, task: Task) -> Text:
            known = task.total is not None and task.time_remaining is not None
            return super().render(task).append(" left") if known else Text()

    console = err()
    room = max(console.width - _COUNTS, 12)
    texts = TextColumn("{task.description}"), TextColumn("{task.fields[now]}")
    columns = (texts[0], BarColumn(bar_width=20), texts[1], TimeLeft(compact=True))
    options: dict[str, Any] = {"transient": True, "disable": not console.is_terminal}
    with Progress(*columns, console=console, speed_estimate_period=_PERIOD, **options) as bar:
        task = bar.add_task(_cut(what, room), total=None, now="")

        def show(done: float, of: float, now: str | None = None, what: str | None = None) -> None:
            words = f"{done:.0f} of {of:.0f}" if now is None else now
            label = None if what is None else _cut(what, room)
            bar.update(task, completed=done, total=of, now=words, description=label)

        yield show


def _cut(text: str, room: int) -> str:
    return text if len(text) <= room else f"{text[: room - 1]}…"


def progress_callback(show: Callable[..., None]) -> Callable[[int, int, str], None]:
    """Adapts the function that `progress` yields to callbacks with the number done, the total, and a label."""
    return lambda done, of, what: show(done, of, what=what)


def start_computing(*, batches: bool = False) -> None:
    """Sets double precision, fast CPU code and the cache of compiled programs, unless already set in this process.

    For batches, every CPU core becomes a device, or as many as $PFTWIN_DEVICES states.
    """
    devices = _cpu_devices() if batches else None
    if "jax" in sys.modules:
        import jax

        settings: Any = jax.config
        if settings.jax_enable_x64 and settings.jax_compilation_cache_dir:
            return
    runtime.configure(cache_dir=True, cpu_devices=devices)


def _cpu_devices() -> int | str:
    given = os.environ.get("PFTWIN_DEVICES", "all")
    if given == "all" or (given.isascii() and given.isdigit() and int(given) > 0):
        return given if given == "all" else int(given)
    raise InputError(f"found {given!r}", where="PFTWIN_DEVICES", expected='"all", or a whole number, at least 1')


def check_suffix(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Raises OutputError for another suffix, with the reason `what` ("results are NetCDF") and the first suffix."""
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{path}: {what}; try: {path.with_suffix(suffixes[0])}")


def check_figure(path: Path | None) -> None:
    """Raises OutputError for an unsupported file type of a figure."""
    if path is not None and path.suffix.lower() not in FIGURES:
        raise OutputError(f"{path}: unknown kind of figure; expected: {', '.join(FIGURES)}")


def save_picture(figure: Figure, path: Path) -> None:
    """Writes a figure atomically."""
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=150)


def check_outputs(*paths: str | os.PathLike[str] | None) -> None:
    """Raises OutputError for unwritable paths and for two outputs to one file, before any work; skips None and "-"."""
    places: set[Path] = set()
    for path in paths:
        if path is None or str(path) == "-":
            continue
        target = check_place(path)
        try:
            with tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}."):
                pass
        except OSError as error:
            raise OutputError(f"{target}: cannot be written: {(error.strerror or str(error)).lower()}") from error
        if (place := target.resolve()) in places:
            raise OutputError(f"{target}: two outputs would go to this file; try: another name for one of them")
        places.add(place)


def check_folder(folder: Path) -> None:
    """Raises OutputError for a folder that cannot be created or written to; creates nothing."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; try: another name for the folder")
    if not may_write(there := nearest_existing(folder)):
        raise OutputError(f"{folder}: cannot be made: no permission to write in {there}")


def nearest_existing(folder: Path) -> Path:
    """Returns the folder, or its nearest existing parent."""
    there = folder.absolute()
    return next(place for place in (there, *there.parents) if place.exists())


def may_write(place: Path) -> bool:
    """Whether a path is a folder in which this user may create files."""
    return place.is_dir() and os.access(place, os.W_OK | os.X_OK)


def write_json(value: Any, to: str | None) -> None:
    """Writes JSON to a file, to stdout ("-"), or nowhere (None); numbers that are not finite become null."""
    if to is None:
        return
    from pftwin.base.text_files import json_text, write_text

    text = json_text(value, lambda _: None, str)
    if to == "-":
        sys.stdout.write(text)
    else:
        write_text(to, text)
