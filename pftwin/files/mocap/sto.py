"""Reads tables from OpenSim's STO and MOT files."""

from __future__ import annotations

import fnmatch
import os
import re
import warnings
from collections.abc import Collection

import numpy as np

from pftwin.base.errors import InputError, PftwinWarning
from pftwin.base.text_files import read_lines, shortened_list
from pftwin.files.mocap.tables import Table, row_values, unknown_name

# Columns that are never angles, whatever inDegrees says: translations, forces, centres of pressure, muscle states; with
# or without a suffix for the side, as in OpenSim JAM's knee_tx_r. Each alternative has a limited length: with \w* a
# search would take quadratic time. The last parts are names that pftwin exports.
_NO_ANGLE = re.compile(
    r"((^|_)t[xyz]|_[vpmf][xyz]\d?|_q[wxyz]|activation|excitation|length)(_r|_l|_right|_left)?$", re.IGNORECASE
)
_NO_ANGLE_PARTS = (  # anywhere in the name's last word
    *("force", "torque", "moment", "cop", "power"),
    *("position", "center", "point", "offset", "indentation"),
)


def read_sto(path: str | os.PathLike[str], *, rotational: Collection[str] | None = None) -> Table:
    """Reads a STO or MOT file; angles are in radians.

    Rows are counted, with a warning if they disagree with the header's nRows or nColumns. The flag inDegrees is used
    and returned as `Table.in_degrees`, but the format does not state which columns are angles. If `rotational` does not
    name them, all columns are taken as angles except those with names of translations (..._tx, ..._tx_r), forces
    (..._vx, ..._px, ...force), moments or muscle states, and a warning lists what was converted.

    Args:
        path: the file.
        rotational: names or patterns ("*_flexion*", "*") of the columns that are angles or angular velocities. Empty:
            none. Used only if the file is in degrees.

    Returns:
        The columns; units are "rad" ("rad/s" for ".../speed") if converted or known to be angles, else "".

    Raises:
        InputError: missing, empty, truncated, binary or non-numeric content (naming file, line and column); no time
            column; repeated or unsorted times; a pattern that matches no column.
    """
    lines, ended = read_lines(path)
    header, labels_at = _header(lines, path)
    labels = [c.strip() for c in lines[labels_at].split("\t" if "\t" in lines[labels_at] else None)]
    while labels and not labels[-1]:
        labels.pop()
    if not labels or labels[0].lower() != "time":
        raise InputError("the first column is not time", where=f"{path}, line {labels_at + 1}", expected="time, ...")
    rows = [(i + 1, cells) for i in range(labels_at + 1, len(lines)) if (cells := lines[i].split())]
    values = row_values(rows, labels, ended=ended, path=path)
    for key, actual in (("nrows", len(values)), ("datarows", len(values)), ("ncolumns", len(labels))):
        if key in header and header[key] != str(actual):
            message = f"{path}: the header says {key}={header[key]}, the file has {actual}, which is used"
            warnings.warn(message, PftwinWarning, stacklevel=2)
    names = tuple(labels[1:])
    flag = header.get("indegrees", "no").lower()
    if flag not in {"yes", "no", "true", "false", "1", "0"}:
        raise InputError(f"inDegrees={flag}", where=f"{path}, header", expected="yes or no")
    in_degrees = flag in {"yes", "true", "1"}
    units = dict.fromkeys(names, "")
    columns = values[:, 1:]
    if in_degrees:
        angles = _angles(names, rotational, path)
        columns[:, [name in angles for name in names]] *= np.pi / 180
        units |= {name: "rad/s" if name.endswith("/speed") else "rad" for name in angles}
    return Table(values[:, 0], names, columns, units, source=str(path), in_degrees=in_degrees)


def _header(lines: list[str], path: object) -> tuple[dict[str, str], int]:
    """Header fields by lower-case name, and the index of the line of labels."""
    header: dict[str, str] = {}
    for i, line in enumerate(lines):
        text = line.strip()
        if text.lower() == "endheader":
            below = [j for j in range(i + 1, len(lines)) if lines[j].strip()]
            if not below:
                raise InputError("nothing after endheader", where=path, expected="a line of labels, then rows")
            return header, below[0]
        key, sign, value = text.partition("=")
        if not sign and len(text.split()) == 2:  # older files: "datarows 12"
            key, value = text.split()
        header[key.strip().lower()] = value.strip()
    raise InputError("no line 'endheader'", where=path, expected="a STO or MOT file with its header")


def _may_be_angle(name: str) -> bool:
    last_word = re.split(r"\W", name)[-1].lower()
    return not (any(part in last_word for part in _NO_ANGLE_PARTS) or _NO_ANGLE.search(name))


def _angles(names: tuple[str, ...], rotational: Collection[str] | None, path: object) -> set[str]:
    if rotational is None:
        # For "/jointset/knee_r/knee_angle_r/value" the coordinate's name decides.
        chosen = {n for n in names if _may_be_angle(re.sub(r"/(value|speed)$", "", n))}
        message = (
            f"{path}: inDegrees=yes, and the format does not say which columns are angles; "
            f"converted to radians: {shortened_list(sorted(chosen)) or 'none'}; name them with rotational=[...]"
        )
        warnings.warn(message, PftwinWarning, stacklevel=3)
        return chosen
    chosen = set()
    for pattern in rotational:
        matches = {n for n in names if fnmatch.fnmatchcase(n, pattern)}
        if not matches:
            raise unknown_name("column", pattern, names, where=path)
        chosen |= matches
    return chosen
