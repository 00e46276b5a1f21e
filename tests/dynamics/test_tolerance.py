"""The step that holds a tolerance: what the estimate promises, over many scenes; what the result says of it."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import OPTIMISED, knee

from pftwin import rig
from pftwin.base.errors import InputError, PftwinWarning
from pftwin.dynamics.batch.batched import batched
from pftwin.dynamics.error_estimate import Course, course_difference
from pftwin.dynamics.frame_states import frame_states
from pftwin.dynamics.integrators import BDF2, LinearImplicit, Newmark
from pftwin.dynamics.simulate import simulate
from pftwin.dynamics.tolerance import Tolerance, Tried, coarsest, parse_tolerance
from pftwin.files.result_files import load_dataset
from pftwin.model.scene import Scene
from tests.benchmarks.problem import with_springs

METRES = Tolerance(1e-5, "m")
J, slow = jnp.asarray, pytest.mark.slow
EACH, REFERENCE = 50, 256  # variants of each case; steps between two frames, of 0.04 ms


def course(center, quaternion) -> Course:
    """A path, and no forces."""
    nothing = np.zeros(center.shape[:-1])
    return Course(center, quaternion, np.zeros_like(center), nothing, nothing)


def distance(a: Course, b: Course) -> float:
    """Root of the mean square over the frames of how far they are apart [m]."""
    return METRES.measure(course_difference(a, b))


def varied(scene: Scene, factors: jax.Array) -> Scene:
    """With other springs, contact stiffness and mass."""
    button = scene.contact
    stiffer = eqx.tree_at(lambda e: e.law.contact_stiffness, button, button.law.contact_stiffness * factors[4])
    scene = with_springs(scene, factors[:4]).with_effect(stiffer)
    body = scene.patella
    heavier = body.mass * factors[5], jax.tree.map(lambda i: i * factors[5], body.inertia)
    return eqx.tree_at(lambda s: (s.patella.mass, s.patella.inertia), scene, heavier)


def one(scene: Scene, integrator: str, substeps) -> tuple[jax.Array, jax.Array]:
    states = frame_states(scene, integrator=integrator, substeps=substeps).states
    center = states.position + states.orientation.rotate(scene.tracked_point() - scene.patella.center_of_mass)
    return center.array(), states.orientation.array()


class Scenes:
    """Two hundred: fifty of each of the rig's cases; paths at any number of steps."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        springs = rng.uniform(0.9, 1.1, (4, EACH, 4))
        others = 10.0 ** rng.uniform(-1, 1, (4, EACH, 1)), 2.0 ** rng.uniform(-1, 1, (4, EACH, 1))
        self.factors = np.concatenate([springs, *others], axis=2)
        parts = [eqx.partition(rig.case(n, contact="P5").unnamed(), eqx.is_array) for n in (1, 2, 3, 4)]
        self.arrays, rest = [arrays for arrays, _ in parts], parts[0][1]
        assert len({str(jax.tree.structure(fixed)) for _, fixed in parts}) == 1  # one program serves all

        def all_paths(arrays, factors, substeps):
            scene = eqx.combine(arrays, rest)
            return batched(lambda f: one(varied(scene, f), BDF2(), substeps))(factors)

        self.compiled = jax.jit(all_paths, compiler_options=OPTIMISED)
        self.known: dict[int, list[Course]] = {}

    def paths(self, n: int) -> list[Course]:
        """One for each scene."""
        if n not in self.known:
            found = [self.compiled(a, J(f), J(n)) for a, f in zip(self.arrays, self.factors, strict=True)]
            self.known[n] = [course(*row) for some in found for row in zip(*map(np.asarray, some), strict=True)]
        return self.known[n]


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    return Scenes()


@pytest.mark.parametrize(
    "tolerance",
    [pytest.param(t, id=f"{1e3 * t:g} mm", marks=slow) for t in (1e-4, 5e-5, 1e-5)],
)
@pytest.mark.filterwarnings("ignore::pftwin.base.errors.PftwinWarning")
def test_the_estimate_bounds_the_error(tolerance, scenes):
    """Of 200 varied scenes 95 in 100, with a factor of 2 allowed; and what was promised is kept as often."""
    order = BDF2().order
    bounded, kept, steps = [], [], []
    for i, fine in enumerate(scenes.paths(REFERENCE)):
        choice = coarsest(lambda n, i=i: Tried(n, scenes.paths(n)[i], True), order, Tolerance(tolerance, "m"))
        true = distance(scenes.paths(choice.run)[i], fine)
        bounded.append(true <= 2 * choice.settings["estimated_error_m"])
        if choice.settings["tolerance_held"]:
            kept.append(true <= tolerance)
            steps.append(choice.substeps)
    assert len(bounded) == 200
    assert np.mean(bounded) >= 0.95
    assert len(kept) >= 180
    assert np.mean(kept) >= 0.95
    assert len(set(steps)) > 2  # scenes differ in what they need


@pytest.fixture(scope="module")
def small():
    return knee(16)


@pytest.mark.slow
def test_it_is_the_run_with_the_step_that_it_names(small):
    found = simulate(small, tolerance="0.01 mm")
    settings = found.settings
    assert settings["integrator"] == BDF2().text
    assert settings["tolerance_held"]
    assert settings["estimated_error_m"] <= settings["tolerance_m"] == pytest.approx(1e-5)
    again = simulate(small, integrator=BDF2(), dt=settings["dt_s"])
    np.testing.assert_allclose(found.center, again.center, atol=1e-12)
    assert found.energies.work == pytest.approx(again.energies.work, abs=1e-9)
    closer = simulate(small, tolerance=1e-7)
    assert closer.settings["substeps"] > settings["substeps"]
    data = found.to_dataset()
    assert data.attrs["estimated_error_m"] == settings["estimated_error_m"]


@pytest.mark.slow
def test_the_error_is_what_it_says(small):
    """Against a path of steps two hundred times as short."""
    found = simulate(small, tolerance="0.01 mm")
    fine = simulate(small, integrator=Newmark(), dt=5e-5)
    error = distance(course(found.center, found.quaternion), course(fine.center, fine.quaternion))
    assert 0.01 * found.settings["estimated_error_m"] < error < 2 * found.settings["estimated_error_m"]


@pytest.mark.slow
def test_what_cannot_be_held_is_said_and_still_handed_out(small, tmp_path):
    with pytest.warns(PftwinWarning, match="not met with 128 steps"):
        found = simulate(small, tolerance="1e-12 mm", integrator=LinearImplicit())
    assert not found.settings["tolerance_held"]
    assert found.settings["substeps"] == 128
    found.save(tmp_path / "found.nc")
    assert load_dataset(tmp_path / "found.nc").attrs["tolerance_held"] == 0


def test_steps_that_are_too_long_count_for_nothing():
    """A path that was not sound, or that is not finite, has no error that is known."""
    straight = course(np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1)))
    lost = course(np.full((5, 3), np.nan), straight.quaternion)
    wild = {1: (straight, False), 2: (lost, True)}
    choice = coarsest(lambda n: Tried(n, *wild.get(n, (straight, True))), 2, METRES)
    assert choice.run == 4
    of = {"tolerance_of": "path, rms over the frames"}
    assert choice.settings == {"tolerance_m": 1e-5, "estimated_error_m": 0.0, "tolerance_held": True, **of}


def test_a_tolerance_of_force_says_that_it_is_of_both_facets_together():
    """A button that rolls from one facet to the other: their forces depend on the step, the resultant does not."""
    straight, n = course(np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1))), np.full(5, 10.0)
    pressed = straight._replace(force=np.tile([0.0, 0.0, 10.0], (5, 1)))
    shares = {1: 0.2, 2: 0.8}
    courses = {k: pressed._replace(medial=share * n, lateral=(1 - share) * n) for k, share in shares.items()}
    choice = coarsest(lambda k: Tried(k, courses[k], True), 2, Tolerance(0.5, "N"))
    assert choice.error.largest["medial_facet"] > 0.5
    assert choice.settings["tolerance_held"]
    assert choice.settings["tolerance_of"] == "contact force, both facets together"


def test_turning_counts_as_way():
    """At 20 mm from the tracked point; which sign a quaternion has does not."""
    a = course(np.zeros((3, 3)), np.tile([1.0, 0, 0, 0], (3, 1)))
    angle = 0.01
    b = course(a.center + np.array([3e-5, 0, 0]), -np.tile([np.cos(angle / 2), 0, np.sin(angle / 2), 0], (3, 1)))
    assert distance(a, b) == pytest.approx(3e-5 + 0.02 * angle)


@pytest.mark.parametrize(
    ("given", "value", "unit"),
    [
        ("0.05 mm", 5e-5, "m"),
        ("20um", 2e-5, "m"),
        ("1e-4 m", 1e-4, "m"),
        (3e-5, 3e-5, "m"),
        ("0.5 N", 0.5, "N"),
        ("20mN", 0.02, "N"),
    ],
)
def test_lengths_and_forces(given, value, unit):
    assert parse_tolerance(given) == (pytest.approx(value), unit)


@pytest.mark.parametrize(
    "given",
    [
        "0.05",
        "mm",
        "0.05 deg",
        "-1 mm",
        "0 mm",
        "nan mm",
        float("inf"),
        0.0,
        "1 mm 2",
        "-1 N",
        "1 n",
        "1 kN m",
        [0.05],
        b"1 mm",
        None,
    ],
)
def test_what_is_neither_length_nor_force(given):
    with pytest.raises(InputError, match=r'"0\.05 mm", or a force such as "0\.5 N"'):
        parse_tolerance(given)


def test_a_step_or_a_tolerance(small):
    with pytest.raises(InputError, match="both dt and tolerance"):
        simulate(small, dt=1e-3, tolerance="1 mm")


def test_newtons_without_any_contact_force_are_refused(small):
    with pytest.raises(
        InputError, match="tolerance: there is no contact force in the whole motion; expected: a length"
    ):
        simulate(small.without("contact"), tolerance="0.001 N")
