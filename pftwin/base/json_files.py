"""JSON from files that may be anything."""

from __future__ import annotations

import json
import os
from typing import Any

from pftwin.base.errors import InputError
from pftwin.base.file_limits import JSON_BYTES
from pftwin.base.text_files import read_bytes


def read_json(path: str | os.PathLike[str], *, expected: str) -> Any:
    """What a JSON file holds.

    Args:
        path: the file.
        expected: what kind of file it is to be, for messages.

    Raises:
        InputError: no such file, more than `JSON_BYTES`, no JSON (naming the line), or lists in lists without end.
    """
    content = read_bytes(path, max_bytes=JSON_BYTES)
    try:
        return json.loads(content.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise InputError(
            f"not valid JSON: {error.msg}", where=f"{path}, line {error.lineno}", expected=expected
        ) from None
    except RecursionError:
        raise InputError("lists within lists without end", where=path, expected=expected) from None
    except ValueError as error:  # no UTF-8, a number of thousands of digits
        raise InputError(f"not readable JSON: {error}", where=path, expected=expected) from None
