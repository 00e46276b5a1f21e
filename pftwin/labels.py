"""What has to be said wherever synthetic data show, in the same words everywhere."""

from __future__ import annotations

VIRTUAL = "the rig is virtual: its recorded motion is synthetic"
