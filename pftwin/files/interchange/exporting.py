"""A result's file in another program's format, chosen by the suffix of the file's name."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pftwin.base.errors import InputError, OutputError

if TYPE_CHECKING:
    from xarray import Dataset

    from pftwin.results.result import Result

Source = Any  # a `Result`, or the path of its file
FORMATS = {
    ".mot": "joint coordinates for OpenSim, angles in degrees",
    ".sto": "everything, as an OpenSim storage",
    ".glb": "the moving knee in three dimensions, glTF 2.0",
    ".csv": "everything, as a table",
}


def export(result: Result | str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes a result in the format that the suffix names: one of `FORMATS`.

    Args:
        result: a result, or the file of one.
        path: where to.

    Raises:
        InputError: no such file, or not a result.
        OutputError: an unknown suffix, or a place that cannot be written to.
    """
    target = check_format(path)
    if target.suffix.lower() == ".glb":
        from pftwin.files.interchange.glb import save_glb

        save_glb(result, target)
        return
    _writer(target.suffix.lower())(_dataset(result), target)


def check_format(path: str | os.PathLike[str]) -> Path:
    """The path, if its suffix is known.

    Raises:
        OutputError: otherwise.
    """
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise OutputError(f"{target}: unknown format {target.suffix!r}; expected: {', '.join(FORMATS)}")
    return target


def _writer(suffix: str) -> Callable[[Dataset, Path], None]:
    from pftwin.files.interchange.mot import save_mot
    from pftwin.files.result_files import save_csv, save_sto

    return {".mot": save_mot, ".sto": save_sto, ".csv": save_csv}[suffix]


def _dataset(result: Source) -> Dataset:
    if not isinstance(result, str | os.PathLike):
        return result.to_dataset()
    from pftwin.files.result_files import load_dataset

    data = load_dataset(result)
    if "patella_quaternion" not in data:
        raise InputError(
            "no motion of a patella in it",
            where=Path(result),
            expected="a result of one simulation",
            remedy="pftwin simulate --case 2 -o case2.nc",
        )
    return data
