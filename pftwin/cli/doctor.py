"""`pftwin doctor`."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from typer import Option

from pftwin import __version__
from pftwin.base.runtime import default_cache_dir, fast_cpu_flags
from pftwin.base.sheet import Sheet
from pftwin.cli.exit_codes import exit_flagged
from pftwin.cli.terminal import (
    JsonOption,
    check_outputs,
    may_write,
    nearest_existing,
    present,
    show,
    spinner,
    start_computing,
)

if TYPE_CHECKING:
    from packaging.requirements import Requirement

FRAMES = 61  # of the self-test: 0.6 s of case 1
MOST_CREATED = 0.005  # largest energy imbalance as a share of the work done; 0.0002 is usual with steps of 1 ms
PROGRAM = "pftwin"
DEVELOPERS = ("benchmarks", "dev", "docs", "test")  # extras for developers, which are not checked


class Finding(NamedTuple):
    """The result of one check."""

    name: str
    found: str
    sound: bool
    remedy: str = ""


class Extra(NamedTuple):
    """An optional extra and its packages."""

    name: str
    packages: dict[str, str | None]  # version by name; None: missing or too old

    @property
    def present(self) -> bool:
        """Whether the extra can be used."""
        return all(v is not None for v in self.packages.values())

    @property
    def remedy(self) -> str:
        """The command that installs the extra."""
        return f"python -m pip install '{PROGRAM}[{self.name}]'"


def doctor(
    *,
    quick: Annotated[bool, Option("--no-self-test", help="Check only the packages; simulate nothing.")] = False,
    json: JsonOption = None,
) -> None:
    """Check this installation: versions, devices, precision, cache, optional parts, and a self-test.

    The self-test simulates half a second of the virtual rig and checks equilibrium and energy. The exit code is 3 if
    something is broken.

    Example: `pftwin doctor`
    """
    check_outputs(json)
    folder = Path(default_cache_dir())
    optional: list[Extra] = []
    with spinner("checking the installation"):
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
    """Runs a check and returns its findings; an exception becomes a finding with its message."""
    try:
        return list(check())
    except Exception as error:
        return [Finding(name, f"{type(error).__name__}: {error}", False, "python -m pip install --upgrade pftwin")]


def _computing() -> list[Finding]:
    """Checks JAX's devices, its precision and the flags for fast CPU code."""
    start_computing()
    import jax
    import jax.numpy as jnp

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
    """Simulates a short motion, and checks the equilibrium at its start, the energy balance and the float type.

    The first run on a machine takes some seconds to compile; later runs use cached programs.
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
    balance = f"residual force {start.residual:.1e} N; at most {start.tolerance:.0e} N"
    budget = f"{100 * share:.2g} % of the work unaccounted for; at most {100 * MOST_CREATED:g} %"
    remedy = "a fresh environment: python -m venv; an empty cache folder"
    return [
        Finding("simulation", f"{ran}: {result.status.describe()}", clean, remedy),
        Finding("equilibrium at the start", balance, start.residual <= start.tolerance, remedy),
        Finding("energy budget", budget, share <= MOST_CREATED, remedy),
        Finding("precision of the run", result.dtype, result.dtype == "float64", "unset JAX_ENABLE_X64"),
    ]


def python() -> Finding:
    """Checks the version of Python against pftwin's metadata."""
    from packaging.specifiers import SpecifierSet

    wanted = metadata.metadata(PROGRAM)["Requires-Python"]
    version = platform.python_version()
    sound = SpecifierSet(wanted).contains(version, prereleases=True)
    return Finding("python", f"{version} ({platform.system()} {platform.machine()})", sound, f"Python {wanted}")


def packages() -> list[Finding]:
    """Checks the version of each package that pftwin requires."""
    return [
        Finding(
            wanted.name,
            _installed(wanted.name) or "not installed",
            _version(wanted) is not None,
            f"python -m pip install '{wanted.name}{wanted.specifier}'",
        )
        for wanted in _requirements(PROGRAM)
    ]


def extras() -> list[Extra]:
    """Returns the optional extras for users."""
    names = metadata.metadata(PROGRAM).get_all("Provides-Extra") or []
    return [
        Extra(name, {w.name: _version(w) for w in _requirements(PROGRAM, name)})
        for name in sorted(names)
        if name not in DEVELOPERS
    ]


def cache(folder: Path) -> Finding:
    """Checks the size and the write permission of the folder of compiled programs."""
    sizes = [f.stat().st_size for f in folder.rglob("*") if f.is_file()] if folder.is_dir() else []
    words = f"{folder}: {len(sizes)} files, {sum(sizes) / 1e6:.1f} MB"
    return Finding(
        "cache", words, may_write(nearest_existing(folder)), "set PFTWIN_CACHE to a folder that can be written to"
    )


def _requirements(package: str, extra: str | None = None) -> list[Requirement]:
    """The requirements of a package on this machine; for an extra, those that it adds."""
    from packaging.requirements import Requirement

    listed = [Requirement(text) for text in metadata.requires(package) or []]
    own = [r for r in listed if r.marker is None or r.marker.evaluate({"extra": ""})]
    if extra is None:
        return own
    known = {(r.name, *r.extras) for r in own}
    added = (r for r in listed if r.marker is not None and r.marker.evaluate({"extra": extra}))
    return [r for r in added if (r.name, *r.extras) not in known]


def _version(wanted: Requirement) -> str | None:
    """The installed version; None if it, or a package of the requested extras, is missing or too old."""
    version = _installed(wanted.name)
    if version is None or not wanted.specifier.contains(version, prereleases=True):
        return None
    for part in (r for extra in wanted.extras for r in _requirements(wanted.name, extra)):
        found = _installed(part.name)
        if found is None or not part.specifier.contains(found, prereleases=True):
            return None
    return version


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
