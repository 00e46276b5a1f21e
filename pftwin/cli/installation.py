"""What is installed where pftwin runs: Python, packages and extras as pftwin's own metadata demand them, the cache."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pftwin.cli.self_test import SelfTestFinding

if TYPE_CHECKING:
    from packaging.requirements import Requirement

PROGRAM = "pftwin"
DEVELOPERS = ("benchmarks", "dev", "docs", "test")  # extras of those who work on pftwin: not looked at


class Extra(NamedTuple):
    """An optional part, and which of its packages are missing."""

    name: str
    packages: dict[str, str | None]  # versions; None: not there, or too old

    @property
    def present(self) -> bool:
        """Whether it can be used."""
        return all(v is not None for v in self.packages.values())

    @property
    def remedy(self) -> str:
        """How to get it."""
        return f"python -m pip install '{PROGRAM}[{self.name}]'"


def python() -> SelfTestFinding:
    """The interpreter, against what pftwin's metadata demand."""
    from packaging.specifiers import SpecifierSet

    wanted = metadata.metadata(PROGRAM)["Requires-Python"]
    version = platform.python_version()
    sound = SpecifierSet(wanted).contains(version, prereleases=True)
    found = f"{version} ({platform.system()} {platform.machine()})"
    return SelfTestFinding("python", found, sound, f"Python {wanted}")


def packages() -> list[SelfTestFinding]:
    """Every package that pftwin needs, with its version."""
    found = []
    for wanted in _requirements(None):
        version = _version(wanted)
        there = _installed(wanted.name) or "not installed"
        remedy = f"python -m pip install '{wanted.name}{wanted.specifier}'"
        found.append(SelfTestFinding(wanted.name, there, version is not None, remedy))
    return found


def extras() -> list[Extra]:
    """The optional parts that users may want."""
    names = metadata.metadata(PROGRAM).get_all("Provides-Extra") or []
    return [
        Extra(name, {w.name: _version(w) for w in _requirements(name)})
        for name in sorted(names)
        if name not in DEVELOPERS
    ]


def cache(folder: Path) -> SelfTestFinding:
    """The folder of compiled programs: how large, and whether it can be written to."""
    import os

    files = [f for f in folder.rglob("*") if f.is_file()] if folder.is_dir() else []
    size = sum(f.stat().st_size for f in files)
    there = folder
    while not there.exists():
        there = there.parent
    sound = there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    words = f"{folder}: {len(files)} files, {size / 1e6:.1f} MB"
    return SelfTestFinding("cache", words, sound, "set PFTWIN_CACHE to a folder that can be written to")


def _requirements(extra: str | None) -> list[Requirement]:
    """What pftwin's metadata demand here; for an extra, what it adds."""
    from packaging.requirements import Requirement

    listed = [Requirement(text) for text in metadata.requires(PROGRAM) or []]
    own = [r for r in listed if r.marker is None or r.marker.evaluate({"extra": ""})]
    if extra is None:
        return own
    named = {(r.name, *r.extras) for r in own}
    return [
        r
        for r in listed
        if (r.name, *r.extras) not in named and r.marker is not None and r.marker.evaluate({"extra": extra})
    ]


def _version(wanted: Requirement) -> str | None:
    """The version, with those of the package's own extras that are asked for; None where something is not there."""
    version = _installed(wanted.name)
    if version is None or not wanted.specifier.contains(version, prereleases=True):
        return None
    from packaging.requirements import Requirement

    for text in metadata.requires(wanted.name) or []:
        inner = Requirement(text)
        asked = [e for e in wanted.extras if inner.marker is not None and inner.marker.evaluate({"extra": e})]
        if asked and inner.marker is not None and not inner.marker.evaluate({"extra": ""}):
            there = _installed(inner.name)
            if there is None or not inner.specifier.contains(there, prereleases=True):
                return None
    return version


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
