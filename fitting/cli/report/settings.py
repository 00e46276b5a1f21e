"""What is needed to compute the same again: files, settings of simulations and fits, versions."""

from __future__ import annotations

import hashlib
import platform
from datetime import UTC, datetime
from typing import Any

from fitting.cli.report.html import PageSection, number, table
from fitting.cli.report.material import Material

_SIMULATED = {
    "integrator": "integrator",
    "dt_s": "longest time step [s]",
    "substeps": "steps between frames",
    "tolerance_m": "tolerance [m]",
    "error_estimate_m": "estimated error [m]",
    "dtype": "numbers",
    "pftwin_version": "pftwin",
    "jax_version": "JAX",
}
_PREDICTED = {"source": "made by", "jax_version": "JAX", "dt": "longest time step [s]", "seed": "seed of the draws"}


def section(material: Material, command: str) -> PageSection:
    """Tables of settings; `command` is what the report was asked for with."""
    parts = [_versions(command)]
    for run in material.runs:
        rows = [(words, _plain(run.data.attrs[key])) for key, words in _SIMULATED.items() if key in run.data.attrs]
        parts.append(table(f"Simulation: {run.name}", ("setting", "value"), rows))
    for name, e in material.estimates.items():
        rows = [
            ("method", e.method),
            ("objective", f"{e.objective}, {number(e.objective_value, 6)} {e.objective_unit}"),
            ("channels", ", ".join(e.channels)),
            ("seed", str(e.seed)),
            ("starts", str(e.starts)),
            ("iterations", str(e.iterations)),
            ("evaluations", str(e.evaluations)),
            ("bounds", "; ".join(_bounds(e))),
            ("versions", "not in the estimate's file"),
        ]
        parts.append(table(f"Fit: {name}", ("setting", "value"), rows))
    if material.treatment is not None:
        about = material.treatment.attrs
        rows = [(words, _plain(about[key])) for key, words in _PREDICTED.items() if key in about]
        parts.append(table("Prediction of treatments", ("setting", "value"), rows))
    rows = [(path.name, f"{path.stat().st_size:,}", _digest(path), _changed(path)) for path in material.files]
    parts.append(table("Files that this report was made from", ("file", "bytes", "SHA-256", "last changed"), rows))
    return PageSection("settings", "Settings and versions", "".join(parts))


def now() -> str:
    """Date and time of this moment, UTC."""
    return _stamp(datetime.now(UTC))


def _versions(command: str) -> str:
    from importlib.metadata import version

    import jax

    from pftwin import __version__

    rows = [
        ("date", now()),
        ("command", command),
        ("pftwin", __version__),
        ("JAX", jax.__version__),
        ("NumPy", version("numpy")),
        ("Python", f"{platform.python_version()} ({platform.system()} {platform.machine()})"),
    ]
    return table("This report", ("made with", "value"), rows)


def _bounds(e: Any) -> list[str]:
    rows = zip(e.names, e.lower, e.upper, e.units, strict=True)
    return [f"{name} {number(low)} to {number(high)} {unit}".rstrip() for name, low, high, unit in rows]


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _digest(path: Any) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _changed(path: Any) -> str:
    return _stamp(datetime.fromtimestamp(path.stat().st_mtime, UTC))


def _stamp(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%d %H:%M UTC")
