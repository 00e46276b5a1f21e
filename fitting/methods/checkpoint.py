"""The state of a fit on disk: written whole or not at all, exact, and of one problem only."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from pftwin.base.errors import InputError
from pftwin.base.output import written_whole
from pftwin.base.text_files import read_json

FORMAT = "pftwin fit checkpoint 1"


def save(path: Path, problem: str, state: dict[str, Any]) -> None:
    """Writes a state.

    Raises:
        OutputError: it cannot be written.
    """
    text = json.dumps({"format": FORMAT, "problem": problem, "state": _plain(state)})
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def load(path: Path, problem: str) -> dict[str, Any]:
    """The state that was saved of this problem.

    Raises:
        InputError: no such file, no checkpoint, or one of another problem.
    """
    content = read_json(path, expected=f"a file of {FORMAT!r}")
    try:
        if content["format"] != FORMAT:
            raise KeyError(content["format"])
        state = _restored(content["state"])
        saved_of = content["problem"]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"no checkpoint of a fit: {error}", where=path, expected=f"a file of {FORMAT!r}") from None
    if saved_of != problem:
        raise InputError(
            "a checkpoint of another problem",
            where=path,
            expected="the same scene, measurements, parameters, bounds, objective, method and seed",
            remedy="the command that it came from, or a fit without it",
        )
    return state


def _plain(value: Any) -> Any:
    """As JSON has it; Python's decimal numbers give back the very same floats."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return {"array": value.ravel().tolist(), "shape": list(value.shape), "dtype": value.dtype.str}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"array", "shape", "dtype"}:
            return np.array(value["array"], dtype=value["dtype"]).reshape(value["shape"])
        return {k: _restored(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_restored(v) for v in value]
    return value
