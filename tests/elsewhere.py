"""A process of its own, for what a process can do once, such as counting its CPU's devices."""

from __future__ import annotations

import os
import subprocess
import sys


def surroundings() -> dict[str, str]:
    """Environment variables with which another Python finds what this one finds, pftwin and the tests' helpers."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(place for place in sys.path if place)}


def elsewhere(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Another Python with these arguments."""
    command, environment = [sys.executable, *arguments], surroundings()
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=900, env=environment)
