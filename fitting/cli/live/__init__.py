"""The live treatment page of `pftwin app`: sliders, and the whole motion simulated at every move of them.

knobs (what can be turned) -> engine (one compiled program per contact) -> threads (the latest wish of each page wins)
-> motion (numbers and arrays of every frame) -> drawing, curves, words -> page, session (one of each for a client)
-> server (all of them).
"""
