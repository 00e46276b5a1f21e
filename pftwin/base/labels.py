"""What has to be said wherever synthetic data show, in the same words everywhere."""

from __future__ import annotations

SYNTHETIC = "the recorded motion is synthetic: a simulated knee's"
