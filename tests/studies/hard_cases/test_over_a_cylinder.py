"""Cases on a patch over a cylinder: the ground is what the case says, and nothing goes round the axis."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import vec

from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.studies.hard_cases import Selection, case_named, method_named, run_matrix
from pftwin.studies.hard_cases.contacts import contact_on
from pftwin.studies.hard_cases.ground import PLATE, axis_below, patch_on
from pftwin.studies.hard_cases.knee import RADIUS
from pftwin.studies.hard_cases.programs import depth_everywhere

J = jnp.asarray
KIND = "P5 cylinder"
HARD = ("touch_without_force", "button_of_1_m", "tendon_soft", "groove_nearly_vertical", "tendon_stiff")


@pytest.fixture(scope="module")
def outcomes() -> dict[str, tuple[str, str]]:
    """Of cases that patches over a plane pass, their equilibria and the touch included."""
    cases = [case_named(name) for name in HARD]
    chosen = Selection(
        (KIND,), (method_named("linear_implicit"),), ("float64",), derivatives=False, batch_independence=False
    )
    return {c.case: (c.outcome, c.reason) for c in run_matrix(cases, chosen)}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.slow
def test_what_a_plane_passes_a_cylinder_passes(outcomes, name):
    assert outcomes[name] == ("pass", "")


def test_a_button_that_is_to_touch_the_plate_exactly_does():
    patch = patch_on(PLATE, KIND)
    jet = patch.jet(J(0.0), J(0.0))
    assert float(jet.f) == axis_below(PLATE, KIND)
    assert abs(float(jet.u)) + abs(float(jet.v)) < 1e-15
    assert abs(float(jet.uu) - 1 / axis_below(PLATE, KIND)) < 0.01 / RADIUS  # a plane, next to the button


@pytest.mark.parametrize("height", [1.0, 0.98, 0.5])
@pytest.mark.parametrize("along", [-0.3, 0.0, 0.2])
def test_the_exhaustive_search_goes_round_the_axis_once_at_most(height, along):
    """For a button of 1 m, whose squares are long enough for many turns, against samples of one turn of its surface."""
    button = contact_on(case_named("button_of_1_m").builder(), KIND).recentred(vec(0, 0, 0))
    assert isinstance(button, SphereContact)
    surface = button.surface
    center = surface.chart.from_frame(vec(along, 0.01, height))
    turn = np.pi * float(surface.chart.radius)
    best = np.array([0.0, 0.0])
    half = np.array([turn, 1.0])
    for _ in range(7):
        u, v = (a.ravel() for a in np.meshgrid(*(best[:, None] + half[:, None] * np.linspace(-1, 1, 201))))
        f = np.asarray(jax.vmap(surface.height)(J(u), J(v)))
        angle = u / float(surface.chart.radius)
        away = np.stack([f * np.sin(angle) - along, v - 0.01, f * np.cos(angle) - height])
        k = np.argmin(np.where((f > 0) & (np.abs(u) <= turn), np.linalg.norm(away, axis=0), np.inf))
        best, half = np.array([u[k], v[k]]), half * 0.05
    expected = 1.0 - np.linalg.norm(away[:, k])
    assert float(depth_everywhere(button, center)) == pytest.approx(expected, abs=2e-6)
