"""Lines nearest to springs that stiffen: against closed forms, the plant's own law, and the rig's recordings."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.demo.straight_springs import (
    PATELLAR_TENDON,
    QUADRICEPS,
    nearest_line,
    recorded_pulls,
    straight_line,
    stretch_under,
)
from pftwin.base.errors import InputError
from pftwin.rig.geometry import CASES, STIFFENING
from tests.verification.rig_plant.mechanics import built_springs
from tests.verification.rig_plant.plant_parts import Spring

K, L0 = 156.0, 0.1432
MORE = STIFFENING / (0.25 * L0)  # F = K s (1 + MORE s)


def plant_force(stretch):
    return K * stretch * (1 + MORE * stretch)


@pytest.fixture(scope="module")
def pulls():
    return recorded_pulls(2)


def test_a_straight_spring_is_its_own_line_whatever_is_missing():
    lengths = np.array([0.10, 0.14, 0.15, 0.17, 0.20, np.nan, 0.21])
    forces = 500 * np.maximum(lengths - 0.13, 0)
    forces[-1] = np.nan
    line = straight_line(lengths, forces)
    np.testing.assert_allclose([line.stiffness, line.slack_length], [500, 0.13], rtol=1e-12)
    assert line.misfit < 1e-12


def test_the_line_of_a_stiffening_spring_over_uniform_stretch_is_known_in_closed_form():
    """Nearest to s + b s^2 over [p, q] is (1 + b (p + q)) s - b (p^2 + 4 p q + q^2) / 6."""
    p, q = 0.03, 0.09
    stretch = np.linspace(p, q, 20001)
    line = straight_line(L0 + stretch, plant_force(stretch))
    slope = 1 + MORE * (p + q)
    assert line.stiffness == pytest.approx(K * slope, rel=1e-6)
    assert line.slack_length == pytest.approx(L0 + MORE * (p**2 + 4 * p * q + q**2) / 6 / slope, rel=1e-6)
    assert line.misfit == pytest.approx(K * MORE * (q - p) ** 2 / (6 * np.sqrt(5)), rel=1e-3)


@pytest.mark.parametrize("stretch", [1e-4, 0.01, 0.08])
def test_the_stretch_under_a_force_is_the_one_at_which_the_plant_pulls_so(stretch):
    spring = Spring(K, L0, 0.0, np.zeros(3), np.zeros(3), STIFFENING)
    assert stretch_under(spring.force(L0 + stretch, 0.0), K, L0) == pytest.approx(stretch, rel=1e-9)


def test_the_plants_law_explains_what_was_recorded(pulls):
    """Lengths, frames and signs are right: forces between 5 and 18 N come out within the noise and the attachments."""
    for pull, spring in zip((pulls[QUADRICEPS], pulls[PATELLAR_TENDON]), built_springs(CASES[2]), strict=True):
        law = np.array([spring.force(length, 0.0) for length in pull.lengths])
        assert np.sqrt(np.mean((law - pull.forces) ** 2)) < 0.3
        assert np.ptp(pull.forces) > 10


def test_both_lines_of_the_rigs_springs_are_steeper_and_start_later(pulls):
    lines = {name: nearest_line(pull) for name, pull in pulls.items()}
    for name, pull in pulls.items():
        stretch = pull.lengths - float(pull.spring.slack_length)
        more = STIFFENING / (0.25 * float(pull.spring.slack_length))
        slopes = float(pull.spring.stiffness) * (1 + 2 * more * np.array([stretch.min(), stretch.max()]))
        assert slopes[0] < lines[name].stiffness < slopes[1]
        assert lines[name].slack_length > float(pull.spring.slack_length)
        assert lines[name].misfit < 0.1
    assert lines[QUADRICEPS].stiffness / K == pytest.approx(1.17, abs=0.01)


def test_misplaced_attachments_shift_the_recorded_slack_length_alone(pulls):
    """By up to a millimetre, more than they change the stiffness: the lines are parallel within some percent."""
    for name in (QUADRICEPS, PATELLAR_TENDON):
        law, sampled = nearest_line(pulls[name]), straight_line(pulls[name].lengths, pulls[name].forces)
        assert 5e-5 < abs(sampled.slack_length - law.slack_length) < 1e-3
        assert sampled.stiffness == pytest.approx(law.stiffness, rel=0.02)


def test_what_is_no_spring_is_refused():
    with pytest.raises(InputError, match="at one length"):
        straight_line([0.1, 0.1], [5.0, 6.0])
    with pytest.raises(InputError, match="at one length"):
        straight_line([0.1, 0.2], [np.nan, 0.0])
    with pytest.raises(InputError, match="forces fall"):
        straight_line([0.1, 0.2], [6.0, 5.0])
