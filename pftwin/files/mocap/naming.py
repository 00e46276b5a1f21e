"""Unknown names: an error that offers the nearest known ones."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from pftwin.base.errors import InputError


def unknown_name(kind: str, name: str, known: Iterable[str], *, where: object) -> InputError:
    """The error for a `kind` ("marker", "column", "unit") called `name` that is not among `known`."""
    known = list(known)
    by_lower = {k.lower(): k for k in reversed(known)}
    close = [by_lower[c] for c in difflib.get_close_matches(name.lower(), list(by_lower), n=3, cutoff=0.5)]
    shown = close or known[:12]
    listed = ", ".join(repr(k) for k in shown) + (", ..." if not close and len(known) > len(shown) else "")
    lead = "did you mean " + listed + "?" if close else "one of " + (listed or "(none there)")
    return InputError(f"no {kind} called {name!r}", where=where, expected=lead)


def quoted(names: Iterable[object], limit: int = 8) -> str:
    """A readable list of the first `limit` names."""
    items = [str(n) for n in names]
    tail = f" and {len(items) - limit} more" if len(items) > limit else ""
    return ", ".join(items[:limit]) + tail
