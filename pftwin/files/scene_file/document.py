"""A scene file as text and data, with the lines of its fields, so that messages can name file, line and field."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from pftwin.base.errors import InputError
from pftwin.base.text_files import SCENE_BYTES, read_lines

Place = tuple[str | int, ...]
MISSING: Any = object()
_OF_ONE_RECORDING = ("rate_Hz", "start_time_s", "end_time_s", "synthetic")  # fields of [motion]

_PART = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_HEADER = re.compile(rf"^\s*(\[\[?)\s*({_PART}(?:\s*\.\s*{_PART})*)\s*\]")
_KEY = re.compile(rf"^\s*({_PART}(?:\s*\.\s*{_PART})*)\s*=")
DEEPEST = 32  # largest nesting depth of tables and lists; scenes have six levels
# Comments and strings, terminated or not. Possessive quantifiers prevent backtracking.
_NO_KEYS = re.compile(
    r"""#[^\n]*+|\"{3}(?:[^"\\]++|\\.|"(?!""))*+(?:\"{3})?|'{3}(?:[^']++|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]++|\\.)*+"?|'[^'\n]*+'?""",
    re.DOTALL,
)
_DEEP_KEY = re.compile(rf"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++){{{DEEPEST}}}")
_DECODE_ERROR = re.compile(r"^(?P<problem>.*) \(at (?P<place>.*)\)$", re.DOTALL)


@dataclass(frozen=True)
class Document:
    """A TOML file: its data, and the line of each field."""

    path: Path
    data: dict[str, Any]
    lines: dict[Place, int] = field(default_factory=dict)
    wrapped: tuple[int, ...] = ()  # ids of values that validation has put into a list of one
    allow_outside: bool = False  # whether it may refer to files outside its folder
    given: Path | None = None  # a file given by the user, which may be anywhere

    @staticmethod
    def read(path: str | os.PathLike[str], *, allow_outside: bool = False) -> Document:
        """Reads a file.

        Raises InputError if it is missing, empty, binary or invalid TOML (naming line and column), or nested deeper
        than `DEEPEST`.
        """
        file = Path(path)
        lines, _ = read_lines(file, max_bytes=SCENE_BYTES)
        text = "\n".join(lines)
        if _DEEP_KEY.search(_NO_KEYS.sub("s", text)):  # before parsing, which takes quadratic time in a key's depth
            raise _too_deep(file)
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            match = _DECODE_ERROR.match(str(error))
            problem, place = (match["problem"], match["place"]) if match else (str(error), "")
            raise InputError(
                f"not valid TOML: {problem[0].lower() + problem[1:]}",
                where=f"{file}, {place}" if place else file,
                remedy="strings need quotes, lists square brackets; see https://toml.io",
            ) from None
        except (ValueError, RecursionError) as error:  # huge numbers, deeply nested lists
            problem = "lists within lists without end" if isinstance(error, RecursionError) else str(error)
            raise InputError(f"not readable TOML: {problem}", where=file) from None
        if _deeper(data, DEEPEST):
            raise _too_deep(file)
        return Document(file, data, _line_numbers(lines, data), allow_outside=allow_outside)

    def with_motion(self, motion: str | os.PathLike[str], rate: float | None) -> Document:
        """The same knee with another recording, of poses or, if the file only has markers, of markers.

        Other measurements and time limits belong to the file's own recording and are removed.
        """
        given, old = Path(motion).resolve(), self.data.get("motion", {})
        if not isinstance(old, dict) or not isinstance(self.data.get("measured", {}), dict):
            return self  # validation reports a wrong type together with all other problems
        kind = "markers" if "markers" in old and "poses" not in old else "poses"
        own = {key: value for key, value in old.items() if key not in (*_OF_ONE_RECORDING, "poses", "markers")}
        data = {**self.data, "motion": {**own, kind: str(given), **({} if rate is None else {"rate_Hz": rate})}}
        if "measured" in data:
            stays = ("patella", "markers") if kind == "markers" else ("patella",)
            data["measured"] = {key: value for key, value in self.data["measured"].items() if key in stays}
            if not data["measured"] and "markers" in self.data["measured"]:
                del data["measured"]
        return replace(self, data=data, given=given)

    def files(self) -> tuple[Path, ...]:
        """The file itself and all files that strings in it may refer to."""
        named = sorted({text for text in _texts(self.data) if text.isprintable()})
        paths = (self.folder / text for text in named)
        own = () if self.given is None else (self.given,)
        return self.path, *own, *(p for p in paths if (self.allow_outside or self._holds(p)) and _is_file(p))

    @property
    def folder(self) -> Path:
        """Folder of the file, to which paths in it are relative."""
        return self.path.parent

    def file(self, name: str) -> Path:
        """Path of a file that a field refers to.

        Raises InputError if it is outside the scene's folder, also by a link, and this is not allowed: a scene file may
        come from an untrusted source, and must not cause other files to be read or shown.
        """
        path = self.folder / name
        if path != self.given and not self.allow_outside and not self._holds(path):
            raise InputError(
                f"{name!r} leads out of the scene's folder",
                expected="a file beside the scene file, or in a folder below",
                remedy="copy it there; or, if you know where the scene comes from, pftwin --allow-outside COMMAND ..., "
                "load_scene(..., allow_outside=True)",
            )
        return path

    def _holds(self, path: Path) -> bool:
        try:
            return path.resolve().is_relative_to(self.folder.resolve())
        except (OSError, RuntimeError, ValueError):  # circular links, invalid names: the file's reader reports them
            return True

    def locate(self, location: Sequence[str | int]) -> tuple[Place, Any, Any]:
        """Converts a location in the validated models: place in the file, enclosing value and value.

        Models have steps that the file does not have: names of alternatives, the index in a list of one that the file
        writes without a list, and metres for a field given in millimetres.
        """
        here: Any = self.data
        parent: Any = self.data
        place: Place = ()
        for step in location:
            if isinstance(step, int) and id(here) in self.wrapped:
                continue
            name: Any = step
            if isinstance(here, dict) and step not in here and f"{step}m" in here:
                name = f"{step}m"
            inside = isinstance(here, dict) and name in here
            inside = inside or (isinstance(here, list) and isinstance(name, int) and name < len(here))
            if inside:
                parent, here, place = here, here[name], (*place, name)
        last = location[-1] if location else None
        if isinstance(last, str) and isinstance(here, dict) and (not place or place[-1] not in (last, f"{last}m")):
            return (*place, last), here, MISSING
        return place, parent, here

    def describe(self, place: Place) -> str:
        """File, line and field: "scene.toml, line 12, [[tendon]] number 2, stiffness_N_per_m"."""
        parts = [str(self.path)]
        known = next((place[:n] for n in range(len(place), 0, -1) if place[:n] in self.lines), None)
        if known is not None:
            parts.append(f"line {self.lines[known]}")
        if place:
            parts.append(_spelled(place, self.data))
        return ", ".join(parts)

    def where(self, *location: str | int) -> str:
        """`describe` for a location in the validated models."""
        return self.describe(self.locate(location)[0])

    @contextmanager
    def naming(self, *location: str | int) -> Iterator[None]:
        """Context manager that prefixes messages of InputErrors with a field's location."""
        try:
            yield
        except InputError as error:
            if str(error).startswith(f"{self.path}, "):
                raise  # already has a more exact location
            raise InputError(str(error), where=self.where(*location)) from error


def _spelled(place: Sequence[str | int], data: dict[str, Any]) -> str:
    head = data.get(str(place[0]))
    if len(place) > 1 and isinstance(place[1], int):
        entry = head[place[1]] if isinstance(head, list) and place[1] < len(head) else None
        name = entry.get("name") if isinstance(entry, dict) else None
        first, rest = f"[[{place[0]}]] number {place[1] + 1}", place[2:]
        first += f" ({name[:60]})" if isinstance(name, str) and name[:60].isprintable() else ""
        separator = ", "
    elif isinstance(head, dict):
        first, rest, separator = f"[{place[0]}]", place[1:], " "
    else:
        first, rest, separator = str(place[0]), place[1:], ""
    text = ""
    for part in rest:
        text += f" number {part + 1}" if isinstance(part, int) else f".{part}" if text else str(part)
    return first + (separator + text if text else "")


def _too_deep(file: Path) -> InputError:
    return InputError(f"tables within tables deeper than {DEEPEST}", where=file, expected="a few, as scenes have")


def _deeper(data: Any, levels: int) -> bool:
    """Whether tables and lists are nested deeper than `levels`; without recursion."""
    layer: list[Any] = [data]
    for _ in range(levels):
        inner = (v.values() if isinstance(v, dict) else v for v in layer if isinstance(v, dict | list))
        layer = list(chain.from_iterable(inner))
    return any(isinstance(v, dict | list) for v in layer)


def _keys(dotted: str) -> list[str]:
    return [part.strip("\"'") for part in re.findall(_PART, dotted)]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # too long for a file name
        return False


def _texts(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict | list):
        for inner in data.values() if isinstance(data, dict) else data:
            yield from _texts(inner)


def _line_numbers(lines: list[str], data: dict[str, Any]) -> dict[Place, int]:
    """Line (from 1) of every table header and key at the start of a line; sufficient for messages."""
    found: dict[Place, int] = {}
    table: Place = ()
    counts: dict[Place, int] = {}

    def with_indices(keys: list[str]) -> Place:
        place: Place = ()
        for key in keys:
            place = (*place, key)
            if place in counts:
                place = (*place, counts[place] - 1)
        return place

    for number, line in enumerate(lines, start=1):
        if header := _HEADER.match(line):
            keys = _keys(header[2])
            table = (*with_indices(keys[:-1]), keys[-1])
            if header[1] == "[[":
                counts[table] = counts.get(table, 0) + 1
                table = (*table, counts[table] - 1)
            found.setdefault(table, number)
        elif key := _KEY.match(line):
            found.setdefault((*table, *_keys(key[1])), number)
    return found
