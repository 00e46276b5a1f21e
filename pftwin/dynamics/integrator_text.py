"""Integrators by their text on the command line and in files: "newmark:rho=0.8", "diffrax:Kvaerno5:rtol=1e-9"."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from pftwin.base.errors import InputError
from pftwin.dynamics.ali3p.step import ALI3P
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import BDF2, Diffrax, LinearImplicit, Newmark, SymplecticEuler
from pftwin.dynamics.quasi_static.step import QuasiStatic

_KINDS: dict[str, type[Integrator]] = {
    kind.name: kind for kind in (LinearImplicit, BDF2, SymplecticEuler, Newmark, QuasiStatic, ALI3P)
}


def integrator_from_text(text: str) -> Integrator:
    """Parses an integrator's name and options.

    Raises:
        InputError: there is no such integrator or option, or the value of an option is invalid.
    """
    name, _, rest = text.partition(":")
    if name == Diffrax.name:
        solver, _, rest = rest.partition(":")
        return Diffrax(solver, **_options(f"{name}:{solver}", rest, Diffrax))
    if name not in _KINDS:
        known = ", ".join((*_KINDS, "diffrax:SOLVER"))
        raise InputError(f"no integrator {name!r}", where="integrator", expected=f"one of: {known}")
    kind = _KINDS[name]
    if rest and not dataclasses.fields(kind):
        raise InputError(f"found options {rest!r}", where=f"integrator {name}", expected="none: it has no options")
    return kind(**_options(name, rest, kind))


def _options(name: str, text: str, kind: type[Integrator]) -> dict[str, Any]:
    known = {f.name: f for f in dataclasses.fields(kind) if f.default is not dataclasses.MISSING}
    values: dict[str, Any] = {}
    for part in text.split(",") if text else []:
        key, _, value = (x.strip() for x in part.partition("="))
        default = known[key].default if key in known else None
        values[key] = value if isinstance(default, str) else _number(value)
        if key not in known or values[key] is None:
            wanted = f"name=value, of: {', '.join(known)}"
            raise InputError(f"found {part.strip()!r}", where=f"integrator {name}", expected=wanted)
    return values


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
