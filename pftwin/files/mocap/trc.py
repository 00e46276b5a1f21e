"""Reads and writes marker trajectories as TRC files (Motion Analysis' text format).

The reader accepts the variants found in practice (compare opensim-core issues 2345, 2289): an optional blank line after
the header, trailing and extra tabs, empty cells, any line ends, coordinate labels that do not count from 1, and header
counts that disagree with the rows (the rows are used, with a warning).
"""

from __future__ import annotations

import itertools
import os
import re
import warnings

import numpy as np

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.text_files import check_row_length, numbers, read_lines, write_text
from pftwin.files.mocap.markers import MarkerTrajectories, from_file
from pftwin.files.mocap.units import length_factor

_COORDINATE = re.compile(r"^[XYZ]\d{0,9}$", re.IGNORECASE)


def read_trc(path: str | os.PathLike[str], *, units: str | None = None) -> MarkerTrajectories:
    """Reads the markers of a TRC file.

    A marker is missing (NaN) on a row if any of its cells is empty or NaN, or if all three are exactly 0 or -0, as
    several systems write it; with a warning also if all three are -9999 or similar.

    Args:
        path: the file.
        units: unit of length, for a file whose header has none or a wrong one (with a warning if they differ).

    Raises:
        InputError: missing, empty, truncated, binary or non-numeric content (naming file, line and column); no, unknown
            or implausible unit; repeated, unsorted or uneven times; gaps in Frame#; coordinates labelled in another
            order than X, Y, Z; a marker that jumps.
    """
    lines, ended = read_lines(path)
    labels_at = _label_line(lines, path)
    header = _header(lines[:labels_at])
    names = tuple(c for c in _cells(lines[labels_at]) if c)[2:]
    if not names:
        where = f"{path}, line {labels_at + 1}"
        raise InputError("no marker names", where=where, expected="names after Frame# and Time")
    _check_axes(lines[: labels_at + 1], lines[labels_at + 1 : labels_at + 3], len(names), path)
    frames, times, positions = _rows(lines, labels_at + 1, names, ended, path)
    if replaced := _placeholders_to_missing(positions):
        message = f"{path}: {replaced} places of markers are -9999 or similar in all coordinates: treated as missing"
        warnings.warn(message, PftwinWarning, stacklevel=2)

    positions *= length_factor(header.get("units"), units, where=f"{path}, header field Units")
    markers = from_file(times, names, positions, path=path, unit_given=units is not None)
    _check_frames(frames, path)
    for message in _disagreements(header, markers):
        warnings.warn(f"{path}: {message}", PftwinWarning, stacklevel=2)
    return markers


def write_trc(path: str | os.PathLike[str], markers: MarkerTrajectories) -> None:
    """Writes markers as a TRC file: millimetres to 1e-6 mm, seconds to 1e-9 s, empty cells for missing markers.

    Raises:
        OutputError: the file cannot be written.
    """
    write_text(path, trc_text(os.path.basename(os.fspath(path)), markers))


def trc_text(name: str, markers: MarkerTrajectories) -> str:
    """Text of a TRC file of this name."""
    n, m = markers.missing.shape
    rate = f"{markers.rate:.12g}" if n > 1 else "1"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{n}\t{m}\tmm\t{rate}\t1\t{n}",
        "Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in markers.names).rstrip("\t"),
        "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, m + 1)),
        "",
    ]
    millimetres = markers.positions * 1e3
    origin = (np.abs(millimetres) < 5e-7).all(axis=-1)
    millimetres[origin, 0] = 1e-6  # exactly 0 0 0 would be read as missing
    for i in range(n):
        cells = ["" if v != v else f"{v:.6f}" for v in millimetres[i].ravel()]
        lines.append(f"{i + 1}\t{markers.times[i]:.9f}\t" + "\t".join(cells))
    return "\n".join(lines) + "\n"


def _cells(line: str) -> list[str]:
    return [c.strip() for c in line.split("\t" if "\t" in line else None)]


def _label_line(lines: list[str], path: object) -> int:
    for i, line in enumerate(lines[:20]):
        cells = [c.lower() for c in _cells(line) if c]
        if cells[:1] and cells[0].startswith("frame") and "time" in cells[1:2]:
            return i
    found = "no line with the marker names (it begins with Frame# and Time)"
    raise InputError(found, where=path, expected="a TRC file with its header")


def _header(lines: list[str]) -> dict[str, str]:
    """Header fields by lower-case name."""
    rows = [_cells(line) for line in lines]
    for keys, values in itertools.pairwise(rows):
        lowered = [k.lower() for k in keys]
        if "datarate" in lowered or "units" in lowered:
            return {k: v for k, v in zip(lowered, values, strict=False) if k and v}
    return {}


def _rows(
    lines: list[str], start: int, names: tuple[str, ...], ended: bool, path: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame numbers (n,), times (n,) and positions (n, m, 3) in the file's unit."""
    width = 2 + 3 * len(names)
    last = max((i for i, line in enumerate(lines) if line.strip()), default=0)
    rows: list[list[float]] = []

    def column(i: int) -> str:
        return ("Frame#", "Time")[i] if i < 2 else f"{names[(i - 2) // 3]} {'XYZ'[(i - 2) % 3]}"

    for i in range(start, len(lines)):
        cells = _cells(lines[i])
        filled = [c for c in cells if c]
        if not filled or (not rows and all(_COORDINATE.match(c) for c in filled)):
            continue
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if i == last and not ended:
            check_row_length(len(cells), max(width, len(cells)), path=path, line=i + 1, broken_off=True)
        if len(cells) < width and (len(cells) - 2) % 3 == 0 and len(cells) > 2:
            cells += [""] * (width - len(cells))  # empty cells that the writer omitted at the end of the row
        check_row_length(len(cells), width, path=path, line=i + 1, broken_off=False)
        numbers(cells[1:2], lambda _: "Time", path=path, line=i + 1, allow_missing=False)
        rows.append(numbers(cells, column, path=path, line=i + 1))
    if not rows:
        raise InputError("no rows of data after the header", where=path, expected="at least one frame")
    values = np.array(rows)
    return values[:, 0], values[:, 1], values[:, 2:].reshape(len(rows), len(names), 3)


def _check_axes(header: list[str], below: list[str], markers: int, path: object) -> None:
    """Checks that coordinates are labelled in the order in which they are read: x, y, z of one marker after another."""
    for number, line in enumerate(header, start=1):
        cells = _cells(line)
        order = next((c for c in cells if re.fullmatch(r"\([xyz](/[xyz]){2}\)", c, re.IGNORECASE)), "")
        if cells[:1] == ["PathFileType"] and order.upper() not in ("", "(X/Y/Z)"):
            raise InputError(f"the axes are {order}", where=f"{path}, line {number}", expected="(X/Y/Z)")
    for number, line in enumerate(below, start=len(header) + 1):
        labels = [c for c in _cells(line) if c]
        if not labels or not all(_COORDINATE.match(c) for c in labels):
            continue
        letters, numbers = "".join(c[0].upper() for c in labels), [int(c[1:]) for c in labels if c[1:]]
        if not ("XYZ" * markers).startswith(letters) or numbers != sorted(numbers):
            raise InputError(
                f"the columns are labelled {', '.join(labels[:6])}",
                where=f"{path}, line {number}",
                expected="X, Y, Z for every marker, in this order, with numbers that ascend",
                remedy="put the columns into this order, or mend the labels if the columns are in it",
            )


def _check_frames(frames: np.ndarray, path: object) -> None:
    """Checks that frame numbers have no gap: the times are uniform, so one of the two would be wrong."""
    if frames.size < 2 or not np.isfinite(frames).all():
        return
    steps, times = np.unique(np.diff(frames), return_counts=True)
    usual = steps[np.argmax(times)]
    if (off := np.flatnonzero(np.diff(frames) != usual)).size:
        i = int(off[0])
        raise InputError(
            f"Frame# goes from {frames[i]:.12g} to {frames[i + 1]:.12g} on row {i + 2}, while the times go on evenly",
            where=path,
            expected=f"steps of {usual:g}, as elsewhere",
            remedy="rows with empty cells for lost frames; number the frames anew if none is lost",
        )


def _placeholders_to_missing(positions: np.ndarray) -> int:
    """Sets positions whose coordinates all are the same number of four or more nines to NaN; returns their count."""
    size = np.abs(positions[..., 0])
    nines = np.isin(size, [10.0**digits - 1 for digits in range(4, 10)])
    found = nines & (positions == positions[..., :1]).all(axis=-1)
    positions[found] = np.nan
    return int(found.sum())


def _disagreements(header: dict[str, str], markers: MarkerTrajectories) -> list[str]:
    found = []
    frames, count = markers.times.size, len(markers.names)
    for key, label, actual in (("numframes", "frames", frames), ("nummarkers", "markers", count)):
        if key in header and not _agrees(header[key], actual, 0):
            found.append(f"the header counts {header[key]} {label}, the file has {actual}: the rows are used")
    if frames > 1 and "datarate" in header and not _agrees(header["datarate"], markers.rate, 0.01 * markers.rate):
        found.append(
            f"the header's rate is {header['datarate']} Hz, the times give {markers.rate:.6g} Hz, which is used"
        )
    return found


def _agrees(text: str, value: float, tolerance: float) -> bool:
    try:
        return abs(float(text) - value) <= tolerance
    except ValueError:
        return False
