"""The live treatment page of `pftwin app`: sliders, and the whole motion simulated anew at every touch of them.

knobs (what can be turned) -> engine (one warm program per contact) -> worker (the latest wish of each page wins)
-> shown (arrays of every frame) -> drawing, curves, words -> session (one page) -> server (all of them).
"""

from __future__ import annotations
