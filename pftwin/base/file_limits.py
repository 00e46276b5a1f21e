"""The largest files that are read. Files are strangers': one over its limit is refused before it takes memory."""

from __future__ import annotations

MIB = 2**20

# Ten minutes of 60 markers at 100 Hz are 100 MB as TRC; of a gait laboratory's C3D with plates at 1 kHz the half.
RECORDING_BYTES = 256 * MIB
SCENE_BYTES = 4 * MIB  # of scene files; the longest known has 40 kB
MODEL_BYTES = 64 * MIB  # of OpenSim's models; whole bodies have 3 MB
JSON_BYTES = 64 * MIB  # of estimates, checkpoints and strands; the checkpoint of 200 members on 50 parameters has 1 MB
MESH_BYTES = 500_000_000  # of a mesh: two million triangles as text
MESH_TRIANGLES = 2_000_000  # a hundred times what a knee's implant takes
RESULT_BYTES = 4_000_000_000  # of a result, in the file or unpacked: 10,000 variants of a second each have 2 GB
RESULT_PACKED = 200  # times what a variable of a result takes in the file; drawings are packed 3 to 20 times
RESULT_SMALL = 50_000_000  # bytes that a variable may be unpacked to however well it is packed
