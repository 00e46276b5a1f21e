"""Frames in the axes of the ISB: x anterior, y proximal, z to the right (Wu et al. 2002)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_scene_files import LIGHT, refused, write_toy

from pftwin.files.scene_file.document import Document
from pftwin.files.scene_file.side import AxesSection, Side

ISB = dict.fromkeys(("femur", "tibia", "patella"), "isb")


@pytest.mark.parametrize(("left", "lateral"), [(False, 1.0), (True, -1.0)])
def test_axes_are_those_of_the_standard(left, lateral):
    """Rightwards is lateral of a right knee and medial of a left one; scenes have (proximal, lateral, anterior)."""
    side = Side.read(left, AxesSection.model_validate(ISB), Document(Path("scene.toml"), {}))
    for body in ISB:
        np.testing.assert_array_equal(side.points(body, [1, 0, 0]), [0, 0, 1])
        np.testing.assert_array_equal(side.points(body, [0, 1, 0]), [1, 0, 0])
        np.testing.assert_array_equal(side.points(body, [0, 0, 1]), [0, lateral, 0])


def test_another_name_is_refused(tmp_path):
    write_toy(tmp_path)
    said = refused(tmp_path, LIGHT + '\n[axes]\nfemur = "isbn"\n')
    assert "[axes] femur: found 'isbn'; expected: one of 'isb'" in said
    assert "problems" not in said
