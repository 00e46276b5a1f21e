"""What is installed where pftwin runs: Python, packages and extras as pftwin's own metadata require them, the cache."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pftwin.cli.terminal import may_write, nearest_existing

if TYPE_CHECKING:
    from packaging.requirements import Requirement

PROGRAM = "pftwin"
DEVELOPERS = ("benchmarks", "dev", "docs", "test")  # extras for work on pftwin itself: not checked


class Finding(NamedTuple):
    """One thing that was checked."""

    name: str
    found: str
    sound: bool
    remedy: str = ""


class Extra(NamedTuple):
    """An optional part, and which of its packages are missing."""

    name: str
    packages: dict[str, str | None]  # versions; None: missing, or too old

    @property
    def present(self) -> bool:
        """Whether it can be used."""
        return all(v is not None for v in self.packages.values())

    @property
    def remedy(self) -> str:
        """How to get it."""
        return f"python -m pip install '{PROGRAM}[{self.name}]'"


def python() -> Finding:
    """The interpreter, against what pftwin's metadata require."""
    from packaging.specifiers import SpecifierSet

    wanted = metadata.metadata(PROGRAM)["Requires-Python"]
    version = platform.python_version()
    sound = SpecifierSet(wanted).contains(version, prereleases=True)
    return Finding("python", f"{version} ({platform.system()} {platform.machine()})", sound, f"Python {wanted}")


def packages() -> list[Finding]:
    """Every package that pftwin needs, with its version."""
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
    """The optional parts that users may want."""
    names = metadata.metadata(PROGRAM).get_all("Provides-Extra") or []
    return [
        Extra(name, {w.name: _version(w) for w in _requirements(PROGRAM, name)})
        for name in sorted(names)
        if name not in DEVELOPERS
    ]


def cache(folder: Path) -> Finding:
    """The folder of compiled programs: how large, and whether it can be written to."""
    sizes = [f.stat().st_size for f in folder.rglob("*") if f.is_file()] if folder.is_dir() else []
    words = f"{folder}: {len(sizes)} files, {sum(sizes) / 1e6:.1f} MB"
    return Finding(
        "cache", words, may_write(nearest_existing(folder)), "set PFTWIN_CACHE to a folder that can be written to"
    )


def _requirements(package: str, extra: str | None = None) -> list[Requirement]:
    """The requirements of a package on this machine; of an extra, those that it adds."""
    from packaging.requirements import Requirement

    listed = [Requirement(text) for text in metadata.requires(package) or []]
    own = [r for r in listed if r.marker is None or r.marker.evaluate({"extra": ""})]
    if extra is None:
        return own
    known = {(r.name, *r.extras) for r in own}
    added = (r for r in listed if r.marker is not None and r.marker.evaluate({"extra": extra}))
    return [r for r in added if (r.name, *r.extras) not in known]


def _version(wanted: Requirement) -> str | None:
    """The installed version; None where it, or a package of the extras that are asked for, is missing or too old."""
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
