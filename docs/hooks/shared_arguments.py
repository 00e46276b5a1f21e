"""Arguments that one line of a docstring describes together ("lower, upper: ...") each get it in the reference."""

from __future__ import annotations

import re
from typing import Any

import griffe

_SHARED = re.compile(r"^(?P<indent> +)(?P<names>\w+(?:, \w+)+): (?P<text>.*)$")
_HEAD = re.compile(r"^(Args|Attributes):$")


class SharedArguments(griffe.Extension):
    """Rewrites the docstrings of functions and classes before they are parsed."""

    def on_function(self, *, func: Any, **_: Any) -> None:
        """Those of functions and methods."""
        _rewrite(func)

    def on_class(self, *, cls: Any, **_: Any) -> None:
        """Those of classes."""
        _rewrite(cls)


def _rewrite(documented: Any) -> None:
    if documented.docstring is not None:
        documented.docstring.value = parted(documented.docstring.value)


def parted(text: str) -> str:
    """A docstring in which every argument has an entry of its own; lines that go on with an entry go with each."""
    lines, out, inside = text.splitlines(), [], False
    for i, line in enumerate(lines):
        inside = bool(_HEAD.match(line)) or (inside and (not line or line.startswith(" ")))
        shared = _SHARED.match(line) if inside else None
        if shared is None:
            out.append(line)
            continue
        more = _continued(lines[i + 1 :], shared["indent"])
        *others, last = shared["names"].split(", ")
        for name in others:
            out += [f"{shared['indent']}{name}: {shared['text']}", *more]
        out.append(f"{shared['indent']}{last}: {shared['text']}")
    return "\n".join(out)


def _continued(lines: list[str], indent: str) -> list[str]:
    """The lines that are indented more deeply than an entry."""
    found = []
    for line in lines:
        if not line.startswith(indent + " "):
            break
        found.append(line)
    return found
