"""Ten times the members take no more memory than their own numbers."""

from __future__ import annotations

import pytest
from elsewhere import elsewhere

from pftwin.base import cache_folder

MORE = 8_640  # members
BYTES = 500  # of a member: its row, summary and status, and copies of them
SLACK = 40.0  # [MiB] of what JAX and Python take meanwhile; all that is seen of their motions at once would be 400
CODE = """
import resource, sys
import pftwin
pftwin.configure(cache_dir=sys.argv[1])
from batch_checks import bent, rows_of
from small_scene import small_scene
scene, sizes = small_scene(101), []
for n in (960, 960 + int(sys.argv[2])):
    pftwin.simulate_batch(pftwin.Variants(scene, bent, rows_of(n)), dt=5e-3, trajectories=False, devices=1)
    sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
print(sizes[1] - sizes[0])
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_the_members():
    done = elsewhere("-c", CODE, str(cache_folder.chosen()), str(MORE))
    assert done.returncode == 0, done.stderr[-2000:]
    assert float(done.stdout) < SLACK + MORE * BYTES / 2**20
