"""The plant whose motion the virtual rig's recordings (`pftwin/rig/data`) are of, and the laboratory that records it.

`mechanics` has the plant and `hand` the motion that it is guided by; `laboratory` writes a motion as the files of a
laboratory, with their noise. The package needs none of it: it reads the recordings.
"""
