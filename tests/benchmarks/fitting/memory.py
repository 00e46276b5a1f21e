"""The most memory that this process has held."""

from __future__ import annotations

from pathlib import Path


def peak() -> float | None:
    """Its largest resident size so far [MiB]; None where the system does not say.

    Linux' own record of this process comes first: what `getrusage` says may be that of the process that started it.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024
    try:
        import resource
    except ImportError:  # Windows
        return None
    import sys

    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / 2**20 if sys.platform == "darwin" else size / 1024
