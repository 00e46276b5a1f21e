"""[[prescribed_tension]] with at_flexion_deg: what is read, what is refused, and another recording's flexion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_scene_files import LIGHT, changed, fixed_poses, load, refused, tibia_poses, write_poses, write_toy

from pftwin import load_scene
from pftwin.model.effects.base import Instant
from pftwin.model.number_place import starting_instant

ENDS = "insertion_mm = [[20, 0, -8], [18, 5, -7]]\norigin_m = [[0.2, 0.01, 0.05], [0.21, 0.03, 0.04]]\n"
KNOTS = (
    '\n[[prescribed_tension]]\nname = "muscles"\nbody = "femur"\ntension_N = [12, 7, 31]\n'
    "at_flexion_deg = [40, 46.5, 52]\n" + ENDS
)


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_toy(tmp_path_factory.mktemp("toy"), LIGHT).parent


def tensions(scene, now: Instant) -> np.ndarray:
    return np.asarray(scene.effect("muscles").tensions(now))


def test_tensions_at_flexions_are_those_of_all_lines_together(toy: Path) -> None:
    """The tibia starts at 45 deg: 5 / 6.5 of the way from 12 N to 7 N."""
    total = 12 - 5 * 5 / 6.5
    even, uneven = load(toy, LIGHT + KNOTS), load(toy, LIGHT + KNOTS + "shares = [1, 3]\n")
    np.testing.assert_allclose(tensions(even, starting_instant(even)), [total / 2, total / 2], rtol=1e-9)
    np.testing.assert_allclose(tensions(uneven, starting_instant(uneven)), [total / 4, 3 * total / 4], rtol=1e-9)
    np.testing.assert_allclose(even.get("muscles.tension"), [12, 7, 31])
    np.testing.assert_allclose(even.effect("muscles").origin_at(3.0).z, [0.05, 0.04])  # type: ignore[attr-defined]


def test_the_flexion_is_that_of_the_recording_it_is_simulated_in(toy: Path) -> None:
    (toy / "pulled.toml").write_text(LIGHT + KNOTS)
    bent = tibia_poses(21, rate=50)
    write_poses(toy / "other.csv", {"tibia": bent, "patella": fixed_poses(bent, (-0.005, 0.001, 0.05), (1, 0, 0, 0))})
    scene = load_scene(toy / "pulled.toml", motion=toy / "other.csv")
    for k, flexion in ((0, 45.0), (10, 55.0), (20, 45.0), (5, 45 + 10 * np.sin(np.pi / 4))):
        femur, tibia = scene.motion.frames(scene.motion.times[k])
        now = starting_instant(scene)
        now = Instant(now.patella, now.femur if femur is None else femur, tibia, float(scene.motion.times[k]), 0.0)
        total = np.interp(flexion, [40, 46.5, 52], [12, 7, 31])
        np.testing.assert_allclose(tensions(scene, now), [total / 2, total / 2], rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[40, 46.5, 52]", "[40, 52, 46.5]", "tensions at flexions of 40, 52, 46.5 deg; expected: at least two"),
        ("[40, 46.5, 52]", "[40, 40, 52]", "each larger than the one before"),
        ("[40, 46.5, 52]", "[40, 52]", "3 tensions at 2 flexions"),
        ("[40, 46.5, 52]", "[]", "at least two flexions"),
        ("[40, 46.5, 52]", "[40]", "tensions at flexions of 40 deg"),
        ("[12, 7, 31]", "[12, -7, 31]", "tension_N"),
        ("tension_N = [12, 7, 31]", 'file = "tension.csv"', "at_flexion_deg with a file"),
        ("at_flexion_deg = [40, 46.5, 52]", "shares = [1, 1]", "shares without at_flexion_deg"),
        ("[40, 46.5, 52]\n", "[40, 46.5, 52]\nshares = [1, 1, 1]\n", "shares has 3 for 2 insertions"),
        ("[40, 46.5, 52]\n", "[40, 46.5, 52]\nshares = [0, 0]\n", "all shares are 0"),
        ("[40, 46.5, 52]\n", "[40, 46.5, 52]\nshares = [1, -1]\n", "shares"),
        ("[40, 46.5, 52]\n", '[40, 46.5, 52]\nlines = ["vas"]\n', "lines has 1 for 2 insertions"),
        ("[0.2, 0.01, 0.05], ", "", "origin_m has 1 for 2 insertions"),
        (ENDS, "", "tensions without ends"),
    ],
)
def test_what_makes_no_tension_by_flexion_is_refused(toy: Path, old: str, new: str, said: str) -> None:
    error = refused(toy, LIGHT + changed(old, new, KNOTS))
    assert said in error
    assert "[[prescribed_tension]]" in error
