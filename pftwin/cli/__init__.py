"""The command line. Commands import what they need when they run, so that `pftwin --help` answers at once."""

from __future__ import annotations

from pftwin.cli.app import app, main

__all__ = ["app", "main"]
