"""Reading and validation of text files, parsing of their numbers, and atomic writing.

Files may come from untrusted sources: one over its size limit is rejected before it is read into memory.
"""

from __future__ import annotations

import csv
import json
import os
import stat
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole

MIB = 2**20

# Ten minutes take 100 MB as TRC (60 markers at 100 Hz) and half of that as C3D with force plates at 1 kHz.
RECORDING_BYTES = 256 * MIB
SCENE_BYTES = 4 * MIB  # scene files; the longest known has 40 kB
MODEL_BYTES = 64 * MIB  # OpenSim models; whole bodies have 3 MB
JSON_BYTES = 64 * MIB  # estimates, checkpoints and strands; the checkpoint of 200 members on 50 parameters has 1 MB
MESH_BYTES = 500_000_000  # a mesh: two million triangles as text
MESH_TRIANGLES = 2_000_000  # a hundred times the size of a knee implant's mesh
RESULT_BYTES = 4_000_000_000  # a result, compressed or not: 10,000 variants of a second each have 2 GB
RESULT_PACKED = 200  # largest compression ratio of a variable; that of drawings is 3 to 20
RESULT_SMALL = 50_000_000  # uncompressed bytes of a variable that are allowed at any ratio

_MISSING = {"", "nan", "-nan", "na", "n/a", "null", "-nan(ind)", "nan(ind)", "-1.#ind", "1.#qnan"}
_TEXT_CONTROLS = {0x09, 0x0A, 0x0B, 0x0C, 0x0D, 0x1A}


def read_bytes(path: str | os.PathLike[str], *, max_bytes: int = RECORDING_BYTES) -> bytes:
    """Content of a file.

    Raises:
        InputError: the file is missing, a folder, a pipe or device, unreadable, empty, or larger than `max_bytes`.
    """
    file = Path(path)
    try:
        found = file.stat()
        if stat.S_ISDIR(found.st_mode):
            raise InputError("is a folder", where=file, expected="a file")
        if not stat.S_ISREG(found.st_mode):  # reading it might never end
            raise InputError("is a device or a pipe", where=file, expected="a file")
        if found.st_size > max_bytes:
            raise InputError(
                f"{found.st_size / MIB:.1f} MiB is too large",
                where=file,
                expected=f"at most {max_bytes / MIB:.0f} MiB",
                remedy="check that it is the file that you mean; cut a long recording",
            )
        content = file.read_bytes()
    except InputError:
        raise
    except FileNotFoundError as err:
        raise InputError("no such file", where=file, remedy="check the path and the working directory") from err
    except OSError as err:
        raise InputError(f"cannot be read: {err.strerror or err}", where=file) from err
    except ValueError as err:  # a name with a zero byte
        raise InputError(f"no name of a file: {err}", where=repr(str(file))) from err
    if not content.strip():
        raise InputError("the file is empty", where=file, expected="data")
    return content


def read_lines(path: str | os.PathLike[str], *, max_bytes: int = RECORDING_BYTES) -> tuple[list[str], bool]:
    """Lines of a text file without line ends (of any convention), and whether the last line ends with one.

    Raises:
        InputError: as `read_bytes`, or the content is not text.
    """
    content = read_bytes(path, max_bytes=max_bytes)
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ("utf-16",)
    else:
        controls = sum(content.count(bytes([c])) for c in range(32) if c not in _TEXT_CONTROLS)
        if controls:
            raise InputError("the content is binary, not text", where=path, expected="a text file of this format")
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        ended = text.endswith(("\n", "\x1a"))
        return text.rstrip("\x1a").split("\n"), ended
    raise InputError("the content is not readable text", where=path, expected="UTF-8 text")


def csv_cells(line: str, *, path: object, number: int, delimiter: str = ",") -> list[str]:
    """Cells of one line of a CSV file; `number` is the line's, from 1.

    Raises:
        InputError: a cell exceeds the field size limit of Python's csv reader.
    """
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except csv.Error:
        raise InputError(
            f"a cell of more than {csv.field_size_limit():,} characters",
            where=f"{path}, line {number}",
            expected="one number or name in a cell",
            remedy="look for a quote that is never closed",
        ) from None


def shortened_list(names: Iterable[object], limit: int = 8, separator: str = ", ") -> str:
    """Formats the first `limit` names with a separator between them, and the number of further ones."""
    items = [str(n) for n in names]
    tail = f" and {len(items) - limit} more" if len(items) > limit else ""
    return separator.join(items[:limit]) + tail


def refuse_repeated(names: Sequence[str], what: str, *, where: object) -> None:
    """Checks that names are unique, as lookups by name require.

    Args:
        names: the names.
        what: what they name ("columns"), for the message.
        where: the file, for the message.

    Raises:
        InputError: names are repeated; the message lists them.
    """
    if repeated := [name for name, times in Counter(names).items() if times > 1]:
        raise InputError(f"{what} that occur twice: {shortened_list(repeated)}", where=where, expected="each once")


def read_json(path: str | os.PathLike[str], *, expected: str) -> Any:
    """Content of a JSON file.

    Args:
        path: the file.
        expected: description of the expected file, for messages.

    Raises:
        InputError: the file is missing, exceeds `JSON_BYTES`, is not JSON (the message gives the line), repeats a name
            in an object, or is nested too deeply.
    """

    def checked(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        refuse_repeated([name for name, _ in pairs], "names in one object", where=path)
        return dict(pairs)

    content = read_bytes(path, max_bytes=JSON_BYTES)
    try:
        return json.loads(content.decode("utf-8-sig"), object_pairs_hook=checked)
    except json.JSONDecodeError as error:
        raise InputError(
            f"not valid JSON: {error.msg}", where=f"{path}, line {error.lineno}", expected=expected
        ) from None
    except RecursionError:
        raise InputError("lists within lists without end", where=path, expected=expected) from None
    except InputError:
        raise
    except ValueError as error:  # not UTF-8, or a number of thousands of digits
        raise InputError(f"not readable JSON: {error}", where=path, expected=expected) from None


def write_json_file(path: str | os.PathLike[str], value: Any) -> None:
    """Writes a JSON file, whole or not at all.

    JSON has no numbers that are not finite: they become the strings "NaN", "Infinity" and "-Infinity", which
    `restored_numbers` turns back.

    Raises:
        OutputError: the place cannot be written to.
    """
    write_text(path, json_text(value, lambda x: "NaN" if np.isnan(x) else "Infinity" if x > 0 else "-Infinity"))


_NOT_FINITE = {"NaN": np.nan, "Infinity": np.inf, "-Infinity": -np.inf}


def json_text(value: Any, not_finite: Callable[[float], str | None], other: Callable[[Any], str] | None = None) -> str:
    """A value as JSON: arrays and sequences as lists.

    `not_finite` gives what stands in place of a number that is not finite; `other` of a value of a type that JSON
    lacks, which is a TypeError without it.
    """

    def as_json(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(key): as_json(own) for key, own in value.items()}
        if hasattr(value, "tolist"):
            return as_json(value.tolist())
        if isinstance(value, float):
            return value if np.isfinite(value) else not_finite(value)
        if isinstance(value, str | int | bool) or value is None:
            return value
        return [as_json(own) for own in value] if isinstance(value, Sequence) else value

    return json.dumps(as_json(value), indent=2, allow_nan=False, default=other) + "\n"


def restored_numbers(value: Any) -> Any:
    """The content of a JSON file with the numbers that `write_json_file` wrote as strings."""
    if isinstance(value, dict):
        return {key: restored_numbers(own) for key, own in value.items()}
    if isinstance(value, list):
        return [restored_numbers(own) for own in value]
    return _NOT_FINITE.get(value, value) if isinstance(value, str) else value


def number(cell: str) -> float:
    """The number in a cell, NaN if the value is missing; raises ValueError for anything else, including infinity."""
    text = cell.strip()
    if text.lower() in _MISSING:
        return float("nan")
    value = float(text)
    if "_" in text or not np.isfinite(value):  # float() also accepts "1_000" and "inf"
        raise ValueError(text)
    return value


def numbers(
    cells: Sequence[str], name_of: Callable[[int], str], *, path: object, line: int, allow_missing: bool = True
) -> list[float]:
    """Numbers of one line; `name_of(i)` is the name of column i.

    Raises:
        InputError: a cell is not a number; the message gives file, line and column.
    """
    out = []
    for i, cell in enumerate(cells):
        try:
            value = number(cell)
        except ValueError:
            comma = cell.count(",") == 1 and "." not in cell
            raise InputError(
                f"column {name_of(i)!r} holds {cell.strip()[:40]!r}, not a number",
                where=f"{path}, line {line}",
                expected="a finite number, or an empty cell where the value is missing",
                remedy="decimal points instead of decimal commas" if comma else None,
            ) from None
        if not allow_missing and value != value:
            raise InputError(f"column {name_of(i)!r} is empty", where=f"{path}, line {line}", expected="a number")
        out.append(value)
    return out


def check_row_length(found: int, wanted: int, *, path: object, line: int, broken_off: bool) -> None:
    """Checks the number of cells in a row; `broken_off`: it is the last line and has no line end.

    Raises:
        InputError: there are too few or too many cells, or the file is truncated; the message gives file and line.
    """
    if found == wanted:
        return
    if found < wanted and broken_off:
        raise InputError(
            f"the file breaks off after {found} of {wanted} columns: it is truncated",
            where=f"{path}, line {line}",
            expected="a complete last line",
            remedy="copy or export the file again",
        )
    raise InputError(f"{found} cells", where=f"{path}, line {line}", expected=f"{wanted} cells as in the header")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file atomically.

    Raises:
        OutputError: the path is not writable.
    """
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
