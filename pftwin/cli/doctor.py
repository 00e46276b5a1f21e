"""`pftwin doctor`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pftwin.cli.exit_codes import flagged
from pftwin.cli.self_test import SelfTestFinding
from pftwin.cli.terminal import JsonOption, check_outputs, out, start_computing, working, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from pftwin.cli.installation import Extra

QuickOption = Annotated[bool, typer.Option("--no-self-test", help="Look at what is installed; simulate nothing.")]


def doctor(*, quick: QuickOption = False, json: JsonOption = None) -> None:
    """Say whether this installation is sound: versions, devices, precision, cache, optional parts, a self-test.

    The self-test simulates half a second of the virtual rig and looks at balance and energy. Ends with exit code 3
    where something is broken.

    Example: `pftwin doctor`
    """
    check_outputs(json)
    from pftwin.base.runtime import default_cache_dir
    from pftwin.cli import installation

    with working("looking"):
        findings = _looked("installation", lambda: [installation.python(), *installation.packages()])
        extras: list[Extra] = []
        if all(f.sound for f in findings):
            extras = installation.extras()
        folder = Path(default_cache_dir())
        findings += _looked("cache", lambda: [installation.cache(folder)])
        findings += _looked("devices", _computing)
    if not quick and all(f.sound for f in findings):
        from pftwin.cli.self_test import self_test

        with working("simulating half a second of the virtual rig"):
            findings += _looked("simulation", self_test)
    broken = [f for f in findings if not f.sound]
    write_json(_facts(findings, extras, folder), json)
    console = out(json)
    console.print(_table(findings))
    if extras:
        console.print(_optional(extras))
    if broken:
        flagged("; ".join(f"{f.name}: {f.found}" for f in broken))
    console.print("sound", markup=False, highlight=False)


def _looked(name: str, look: Callable[[], Sequence[SelfTestFinding]]) -> list[SelfTestFinding]:
    """What was found; a look that itself fails is a finding too, with the error's words."""
    try:
        return list(look())
    except Exception as error:
        return [
            SelfTestFinding(name, f"{type(error).__name__}: {error}", False, "python -m pip install --upgrade pftwin")
        ]


def _computing() -> list[SelfTestFinding]:
    """The devices that JAX sees, its precision, and the fast CPU compilation."""
    start_computing()
    import jax
    import jax.numpy as jnp

    from pftwin.base.runtime import fast_cpu_flags

    devices = [f"{d.platform}:{d.id} {d.device_kind}" for d in jax.devices()]
    precision = str(jnp.zeros(1).dtype)
    flags = os.environ.get("XLA_FLAGS", "")
    fast = set(fast_cpu_flags(flags).split()) == set(flags.split())
    return [
        SelfTestFinding("devices", ", ".join(devices), bool(devices)),
        SelfTestFinding("precision", precision, precision == "float64", "unset JAX_ENABLE_X64"),
        SelfTestFinding("fast CPU code", "on" if fast else f"off: XLA_FLAGS={flags}", fast, "unset XLA_FLAGS"),
    ]


def _facts(findings: list[SelfTestFinding], extras: list[Extra], folder: Path) -> dict[str, Any]:
    from pftwin import __version__

    return {
        "pftwin": __version__,
        "sound": all(f.sound for f in findings),
        "findings": [f._asdict() for f in findings],
        "extras": {e.name: {"present": e.present, "packages": e.packages, "install": e.remedy} for e in extras},
        "cache": str(folder),
    }


def _table(findings: list[SelfTestFinding]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from pftwin import __version__

    table = Table(box=None, title=f"pftwin {__version__}", title_justify="left")
    for name in ("", "found", ""):
        table.add_column(name)
    for f in findings:
        verdict = "[green]ok[/green]" if f.sound else f"[red]BROKEN[/red]; try: {escape(f.remedy)}"
        table.add_row(f.name, escape(f.found), verdict)
    return table


def _optional(extras: list[Extra]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, title="optional parts", title_justify="left")
    for name in ("", "found", ""):
        table.add_column(name)
    for e in extras:
        there = ", ".join(f"{name} {version}" for name, version in e.packages.items() if version)
        table.add_row(e.name, there or "-", "there" if e.present else escape(e.remedy))
    return table
