"""`pftwin doctor`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

from typer import Option

from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import exit_flagged
from pftwin.cli.installation import Extra, Finding, cache, extras, packages, python
from pftwin.cli.terminal import JsonOption, check_outputs, present, show, spinner, start_computing

FRAMES = 61  # of the self-test: 0.6 s of case 1
MOST_CREATED = 0.005  # energy that no account explains, as a share of the work done: 0.0002 with steps of 1 ms


def doctor(
    *,
    quick: Annotated[bool, Option("--no-self-test", help="Look at what is installed; simulate nothing.")] = False,
    json: JsonOption = None,
) -> None:
    """Say whether this installation is sound: versions, devices, precision, cache, optional parts, a self-test.

    The self-test simulates half a second of the virtual rig and looks at balance and energy. Ends with exit code 3
    where something is broken.

    Example: `pftwin doctor`
    """
    check_outputs(json)
    from pftwin import __version__
    from pftwin.base.runtime import default_cache_dir

    folder = Path(default_cache_dir())
    optional: list[Extra] = []
    with spinner("looking"):
        findings = _checked("installation", lambda: [python(), *packages()])
        if all(f.sound for f in findings):
            optional = extras()
        findings += _checked("cache", lambda: [cache(folder)])
        findings += _checked("devices", _computing)
    if not quick and all(f.sound for f in findings):
        with spinner("simulating half a second of the virtual rig"):
            findings += _checked("simulation", self_test)
    broken = [f for f in findings if not f.sound]
    facts = {
        "pftwin": __version__,
        "sound": not broken,
        "findings": [f._asdict() for f in findings],
        "extras": {e.name: {"present": e.present, "packages": e.packages, "install": e.remedy} for e in optional},
        "cache": str(folder),
    }
    headings = ("", "found", "")
    rows = tuple((f.name, f.found, "ok" if f.sound else f"BROKEN; try: {f.remedy}") for f in findings)
    parts = [Sheet(f"pftwin {__version__}", headings, rows)]
    if optional:
        there = (", ".join(f"{name} {version}" for name, version in e.packages.items() if version) for e in optional)
        rows = tuple(
            (e.name, t or "-", "there" if e.present else e.remedy) for e, t in zip(optional, there, strict=True)
        )
        parts.append(Sheet("optional parts", headings, rows))
    present(facts, *parts, json=json)
    if broken:
        exit_flagged("; ".join(f"{f.name}: {f.found}" for f in broken))
    show("sound", json=json)


def _checked(name: str, check: Callable[[], Sequence[Finding]]) -> list[Finding]:
    """What a check found; a check that itself fails is a finding too, with the error's words."""
    try:
        return list(check())
    except Exception as error:
        return [Finding(name, f"{type(error).__name__}: {error}", False, "python -m pip install --upgrade pftwin")]


def _computing() -> list[Finding]:
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
        Finding("devices", ", ".join(devices), bool(devices)),
        Finding("precision", precision, precision == "float64", "unset JAX_ENABLE_X64"),
        Finding("fast CPU code", "on" if fast else f"off: XLA_FLAGS={flags}", fast, "unset XLA_FLAGS"),
    ]


def self_test() -> list[Finding]:
    """Simulates, and checks what must hold of any run: balance at the start, energy, the float type.

    The first run on a machine compiles for some seconds; kept programs make the next one short.
    """
    import dataclasses
    import time

    import numpy as np

    from pftwin import rig
    from pftwin.dynamics.simulate import simulate
    from pftwin.dynamics.status import Status

    began = time.perf_counter()
    scene = rig.case(1)
    scene = dataclasses.replace(scene, motion=dataclasses.replace(scene.motion, n_frames=FRAMES))
    result = simulate(scene)
    seconds = time.perf_counter() - began
    start, energies = result.equilibrium, result.energies
    assert energies.work is not None
    assert energies.budget_error is not None
    work, created = (float(np.abs(v).max()) for v in (energies.work, energies.budget_error))
    share = created / work if work > 0 else float("nan")
    finite = bool(np.isfinite(result.position).all() and np.isfinite(result.quaternion).all())
    clean = finite and Status.NOT_FINITE not in result.status
    ran = f"{FRAMES} frames of case 1 in {seconds:.1f} s, compiling included"
    balance = f"{start.residual:.1e} N left over of the forces; at most {start.tolerance:.0e} N"
    budget = f"{100 * share:.2g} % of the work unaccounted for; at most {100 * MOST_CREATED:g} %"
    remedy = "a fresh environment: python -m venv; an empty cache folder"
    return [
        Finding("simulation", f"{ran}: {result.status.describe()}", clean, remedy),
        Finding("equilibrium at the start", balance, start.residual <= start.tolerance, remedy),
        Finding("energy budget", budget, share <= MOST_CREATED, remedy),
        Finding("precision of the run", result.dtype, result.dtype == "float64", "unset JAX_ENABLE_X64"),
    ]
