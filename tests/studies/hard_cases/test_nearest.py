"""The exhaustive search for how deep a button is, on an open mesh: below its middle, and past its rim."""

from __future__ import annotations

import pytest
from scenes import vec

from pftwin.studies.hard_cases.contacts import contact_on
from pftwin.studies.hard_cases.ground import PLATE
from pftwin.studies.hard_cases.knee import RADIUS, KneeNumbers
from pftwin.studies.hard_cases.nearest import depth_everywhere

WIDE = PLATE.half[1]  # [m]


@pytest.fixture(scope="module")
def button():
    return contact_on(KneeNumbers(ground=PLATE), "volume").recentred(vec(0, 0, 0))


@pytest.mark.parametrize(
    ("place", "depth"),
    [
        ((0.004, 0.006, RADIUS - 1e-3), 1e-3),
        ((0.0, 0.0, -0.05), RADIUS + 0.05),  # below the middle: on an edge inside the mesh
        ((0.004, 0.006, -0.05), RADIUS + 0.05),
        ((0.004, WIDE + 0.03, -0.04), RADIUS - 0.05),  # 50 mm past the rim, and below: no inside
        ((WIDE + 0.03, WIDE, -0.04), RADIUS - 0.05),
        ((0.004, WIDE + 0.003, 0.004), RADIUS - 0.005),
    ],
)
def test_an_open_mesh_has_no_inside_past_its_rim(button, place, depth):
    assert float(depth_everywhere(button, vec(*place))) == pytest.approx(depth, abs=1e-12)
