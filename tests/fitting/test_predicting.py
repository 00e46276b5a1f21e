"""Predictions: the same as single runs, whatever the chunks; members that fail are marked; what is wrong is named."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

from fitting.prediction import predicting
from fitting.prediction.members import MemberPrograms, Members, Recipe
from fitting.prediction.outcomes import MEASURES, Groove, outcomes
from fitting.prediction.plots import draws_failed, main_finding
from fitting.prediction.predicting import CHUNK, STEP, Fitted, predict
from fitting.prediction.untreated import NO_EQUILIBRIUM, untrusted_starts
from fitting.prediction.variants import batches, grid
from fitting.treatments import Treatment, tibial_tuberosity_transfer
from pftwin import BDF2, equilibrium, rig, simulate
from pftwin.base.errors import InputError
from pftwin.dynamics.status import FLAGS, Status
from pftwin.model.measured import SYNTHETIC
from pftwin.results.tracking import DISLOCATED

TRANSFER = "tibial_tuberosity_transfer"
MEDIAL = f"{TRANSFER}_medialisation"
DT = 5e-3


@pytest.fixture(scope="module")
def case_2():
    """Case 2 with its tuberosity up to 20 mm medial."""
    return predict(rig.case(2), grid(TRANSFER, medialisation=1e-3 * np.arange(0, 21, 2)))


@pytest.mark.slow
def test_medialisation_cures_case_2(case_2):
    out = case_2["dislocations"].values > 0
    np.testing.assert_array_equal(case_2[MEDIAL].values[out], [0.0, 0.002])
    assert (np.diff(case_2["largest_offset"].values[~out]) < 0).all()
    assert (np.diff(case_2["medial_share"].values[~out]) > 0).all()
    assert case_2["dislocation_flexion"].values[0] == pytest.approx(14.7, abs=0.1)  # in steps of 5 to 1/16 ms
    assert case_2["dislocation_flexion"].attrs["units"] == "deg"
    assert not case_2["failed"].values.any()


@pytest.mark.slow
def test_a_member_is_what_simulate_gives(case_2):
    one = outcomes(simulate(tibial_tuberosity_transfer(rig.case(2), 0.010), dt=STEP, integrator=BDF2()))
    member = case_2.isel(variant=5)
    for name, measure in MEASURES.items():
        expected = np.degrees(one[name]) if measure.unit == "rad" else one[name]
        np.testing.assert_allclose(member[name], expected, rtol=1e-6, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_case_1_is_case_2_after_the_transfer():
    one, two = rig.case(1), rig.case(2)
    moved = eqx.tree_at(lambda s: (s.motion, s.start), two, (one.motion, one.start))
    variants = [Treatment.of(TRANSFER, medialisation=m) for m in (0.0, 0.016)]
    found = predict([one, moved], variants)
    assert list(found["scene"].values) == [one.name] * 2 + [two.name] * 2
    for name in MEASURES:
        np.testing.assert_allclose(found[name][3], found[name][0], rtol=1e-6, atol=1e-9, err_msg=name)
    assert float(found["largest_offset"][2]) > float(found["largest_offset"][0])
    assert float(found["dislocations"][0]) == 0


@pytest.fixture(scope="module")
def knee():
    return small_scene()


@dataclass(eq=False)
class Estimated(Fitted):
    """An estimate of two numbers."""

    names: tuple[str, ...] = ("K1", "L2")
    units: tuple[str, ...] = ("N/m", "m")
    values: np.ndarray = field(default_factory=lambda: np.array([160.0, 0.0715]))
    synthetic: bool = True
    source: str = "a test"

    def apply(self, scene, theta=None):
        stiffness, length = self.values if theta is None else theta
        q, p = (scene.effect(n) for n in ("quadriceps", "patellar_tendon"))
        scene = scene.with_effect(eqx.tree_at(lambda t: t.stiffness, q, jnp.asarray(stiffness)))
        return scene.with_effect(eqx.tree_at(lambda t: t.slack_length, p, jnp.asarray(length)))

    def samples(self, count, seed=0):
        random = np.random.default_rng(seed)
        return self.values + np.array([3.0, 1e-4]) * random.standard_normal((count, 2))


class Doubted(Estimated):
    """One whose measurements are doubted."""

    doubts = ("the forces look as if they were in kN",)


ESTIMATED = Estimated()  # one, as programs know an estimate by its identity
VARIANTS = [
    grid(TRANSFER, medialisation=np.linspace(0, 0.012, 4), distalisation=[0.0, 0.003]),
    Treatment.of("quadriceps_lengthening", lengthening=0.004),
    Treatment.of(TRANSFER, medialisation=0.5e-3, distalisation=0.001),
]
TRANSFERS = [VARIANTS[0], VARIANTS[2]]


@pytest.fixture(scope="module")
def sampled(knee):
    """The variants of one form: one program."""
    return predict(knee, TRANSFERS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1)


def test_variants_stand_in_the_order_they_were_given(knee, monkeypatch):
    """Each with its own numbers and draws, as whoever simulates the members of each form is given them."""

    def run(recipe, amounts, thetas, *more, **options):
        found = (7 if len(amounts) < 20 else 3) * amounts.sum(axis=1) + thetas[:, 0]
        flags = np.zeros((len(amounts), len(FLAGS)), int)
        return Members(dict.fromkeys(MEASURES, found), flags, np.ones(len(amounts), bool), {})

    monkeypatch.setattr(predicting, "run", run)
    found = predict(knee, VARIANTS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1)
    assert found.sizes["variant"] == 10
    assert found.sizes["sample"] == 7
    assert found["treatment"].values[8] == "quadriceps tendon 4 mm longer"
    assert found["treatment"].values[3] == "tibial tuberosity 4 mm medially, 3 mm distally"
    medially, distally = (1e-3 * np.array([0, 0, 4, 4, 8, 8, 12, 12, 0, 0.5]), 1e-3 * np.array([*4 * [0, 3], 0, 1]))
    np.testing.assert_allclose(found[MEDIAL].values, medially)
    longer = found["quadriceps_lengthening_lengthening"].values
    np.testing.assert_allclose(longer, [0] * 8 + [0.004, 0])
    assert found[MEDIAL].attrs["units"] == "m"
    assert found.attrs["synthetic"] == 1
    assert found.attrs["note"] == "the parameters were estimated from synthetic measurements"
    stiffness = [160.0, *ESTIMATED.samples(6, 3)[:, 0]]
    expected = np.add.outer(3 * (medially + distally) + 7 * longer, stiffness)
    np.testing.assert_allclose(found["mean_contact_force"].values, expected)


def test_nothing_is_concluded_from_an_estimate_that_is_invalid(knee, monkeypatch):
    def run(recipe, amounts, thetas, *more, **options):
        out = {name: np.ones(len(amounts)) for name in MEASURES}
        return Members(out, np.zeros((len(amounts), len(FLAGS)), int), np.ones(len(amounts), bool), {})

    monkeypatch.setattr(predicting, "run", run)
    by = [
        main_finding(predict(knee, TRANSFERS, e, samples=6, seed=3, dt=DT, devices=1)) for e in (ESTIMATED, Doubted())
    ]
    assert by == ["no variant tracks", "INVALID: the forces look as if they were in kN"]


def test_a_knee_that_starts_invalid_has_no_valid_variant(sampled, knee):
    """As `simulate` says of it: the small knee's equilibrium is 17.1 deg from where its search begins."""
    found = predict(knee.with_limits(), TRANSFERS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1)
    turned = np.degrees(equilibrium(ESTIMATED.apply(knee)).turned)
    said = f"INVALID: the equilibrium is {turned:.1f} deg from the recorded start (at most 15: most_start_turn_deg)"
    assert set(found["verdict"].values) == {said}
    assert found["failed"].values.all()
    assert np.isnan(found["mean_contact_force"].values).all()
    near = knee.with_limits(most_start_turn_deg=20)
    found = predict(near, TRANSFERS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1)
    np.testing.assert_array_equal(found["failed"], sampled["failed"])
    assert not found["failed"].values.all()


def test_draws_that_start_invalid_are_in_no_band(sampled, knee):
    """Whatever their treatment; the equilibrium of each, as `pftwin.equilibrium` reports it, says which they are."""
    turned = np.degrees([equilibrium(ESTIMATED.apply(knee, t)).turned for t in ESTIMATED.samples(6, 3)])
    third, second = np.sort(turned)[-3:-1]
    estimated = np.degrees(equilibrium(ESTIMATED.apply(knee)).turned)
    assert estimated < second
    near = knee.with_limits(most_start_turn_deg=float(0.5 * (max(third, estimated) + second)))
    found = predict(near, TRANSFERS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1)
    out = np.array([False, *(turned >= second)])
    assert not sampled["failed"].values.any()
    np.testing.assert_array_equal(found["failed"].values, np.tile(out, (found.sizes["variant"], 1)))
    assert set(draws_failed(found)) == {2}
    force = sampled["mean_contact_force"].values
    np.testing.assert_allclose(found["mean_contact_force"].values, np.where(out, np.nan, force), rtol=1e-9)


def test_a_draw_without_untreated_equilibrium_is_lost_without_limits_too(knee):
    """Nothing holds a patella whose quadriceps has no stiffness."""
    (batch,) = batches([knee], TRANSFERS)
    recipe = Recipe(knee, batch.treatment, ESTIMATED.apply, Groove.of(knee), jnp.asarray(2), DISLOCATED, False)
    thetas = np.array([[160.0, 0.0715], [1e-6, 0.0715], [161.0, 0.0715]])
    assert [equilibrium(ESTIMATED.apply(knee, t)).converged for t in thetas] == [True, False, True]
    programs = MemberPrograms(recipe, 7 * len(batch.amounts), CHUNK, 1)  # those of `sampled`
    assert untrusted_starts(programs, knee, thetas) == [(), (NO_EQUILIBRIUM,), ()]


def test_a_prediction_is_synthetic_where_its_motion_or_its_estimates_measurements_are(knee, monkeypatch):
    def run(recipe, amounts, *more, **options):
        many = len(amounts)
        return Members(
            dict.fromkeys(MEASURES, np.zeros(many)), np.zeros((many, len(FLAGS)), int), np.ones(many, bool), {}
        )

    monkeypatch.setattr(predicting, "run", run)
    monkeypatch.setattr(predicting, "untrusted_starts", lambda programs, scene, thetas: [()] * len(thetas))
    made = {
        (motion, learned): predict(
            dataclasses.replace(knee, synthetic=motion), VARIANTS[1], Estimated(synthetic=learned), dt=DT, devices=1
        ).attrs
        for motion in (False, True)
        for learned in (False, True)
    }
    assert {of: attributes["synthetic"] for of, attributes in made.items()} == {of: int(any(of)) for of in made}
    assert {of: "note" in attributes for of, attributes in made.items()} == {of: any(of) for of in made}


@pytest.mark.slow
def test_a_synthetic_motion_is_reported(case_2):
    assert case_2.attrs["note"] == SYNTHETIC
    assert case_2.attrs["synthetic"] == 1


def test_samples_lie_around_the_estimate(sampled, knee):
    np.testing.assert_allclose(sampled["parameters"].values[0], [160.0, 0.0715])
    force = sampled["mean_contact_force"].values
    assert np.ptp(force, axis=1).min() > 0.01  # N
    treated = Treatment.of(TRANSFER, medialisation=0.004, distalisation=0.003)(ESTIMATED.apply(knee))
    assert force[3, 0] == pytest.approx(
        outcomes(simulate(treated, dt=DT, integrator=BDF2()))["mean_contact_force"], rel=1e-7
    )
    draw = ESTIMATED.apply(knee, ESTIMATED.samples(6, 3)[1])
    treated = Treatment.of(TRANSFER, medialisation=0.5e-3, distalisation=0.001)(draw)
    assert force[8, 2] == pytest.approx(
        outcomes(simulate(treated, dt=DT, integrator=BDF2()))["mean_contact_force"], rel=1e-7
    )


@pytest.mark.slow
def test_chunks_do_not_change_the_answer(knee):
    sampled, calls = predict(knee, VARIANTS, ESTIMATED, samples=6, seed=3, dt=DT, devices=1), []
    small = predict(knee, VARIANTS, ESTIMATED, samples=6, seed=3, dt=DT, chunk=16, progress=lambda *a: calls.append(a))
    for name in MEASURES:
        np.testing.assert_allclose(small[name], sampled[name], rtol=1e-7, atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(small["status_frames"], sampled["status_frames"])
    assert max(calls) == (70, 70)


@pytest.mark.slow
def test_members_that_cannot_be_simulated_are_marked(knee):
    lengths = [-0.001, -0.0715, -0.5, 0.0]
    found = predict(knee, grid("patellar_tendon_length_change", lengthening=lengths), dt=DT)
    np.testing.assert_array_equal(found["failed"].values, [False, True, True, False])
    for name in MEASURES:
        assert np.isnan(found[name].values[1:3]).all()
    assert np.isfinite(found["peak_contact_force"].values[[0, 3]]).all()
    assert found["status_frames"].sizes == {"variant": 4, "flag": len(Status)}


@pytest.mark.slow
def test_trajectories_come_along_where_wanted(knee, tmp_path):
    found = predict(knee, grid(TRANSFER, medialisation=[0.0, 0.01]), dt=DT, trajectories=True)
    assert found["sphere_center"].dims == ("variant", "time", "axis")
    result = simulate(tibial_tuberosity_transfer(knee, 0.01), dt=DT, integrator=BDF2())
    np.testing.assert_allclose(found["sphere_center"].values[1], result.center, atol=1e-9)
    np.testing.assert_allclose(found["force_lateral"].values[1], result.effects["contact"]["force_lateral"], atol=1e-5)
    np.testing.assert_allclose(found["patella_tilt"].values[1], np.degrees(result.angles.tilt), atol=1e-6)
    found.to_netcdf(tmp_path / "variants.nc", engine="h5netcdf")


def test_grid_has_all_combinations():
    both = grid(TRANSFER, medialisation=[0.0, 0.01, 0.02], distalisation=[0.0, 0.005])
    np.testing.assert_allclose(both.values[0], [0, 0, 0.01, 0.01, 0.02, 0.02])
    np.testing.assert_allclose(both.values[1], [0, 0.005] * 3)
    composed = Treatment.of(TRANSFER, medialisation=0.01).then(Treatment.of("trochleoplasty", deepening=0.0))
    deeper = grid(composed, {"trochleoplasty.deepening": [0.0, 0.002]})
    np.testing.assert_allclose(deeper.values[0], [0.01, 0.01])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: predict([], None), "nothing to predict"),
        (lambda s: predict(s, []), "nothing to predict"),
        (lambda s: predict(s, ["transfer"]), r"found 'transfer'.*expected: treatments"),
        (lambda s: predict([s, "case 2"]), r"found 'case 2'.*expected: scenes"),
        (lambda s: predict(s, samples=5), r"samples without an estimate.*estimate"),
        (lambda s: predict(s, dt=0.0), r"dt: found 0\.0; expected: a positive"),
        (lambda s: predict(s, threshold=-1.0), r"threshold: found -1\.0"),
        (lambda s: predict(s, chunk=0), "chunk: found 0; expected: a whole number, at least 1"),
        (lambda s: predict(s, Treatment.of("mpfl_graft", shortening=0.001)), "no tendon or strands named 'mpfl'"),
        (lambda s: predict(s.without("contact")), "no contact between a button and a trochlea"),
        (
            lambda s: predict(s, grid(TRANSFER, medialisation=np.linspace(0, 0.01, 5000)), trajectories=True),
            r"trajectories of 5000 members.*at most 4096",
        ),
        (lambda s: grid(TRANSFER, medialization=[0.0]), "no amount 'medialization'"),
        (lambda s: grid(TRANSFER, medialisation=[]), r"found \[\]"),
        (lambda s: grid(TRANSFER, medialisation=[0.0, np.inf]), "a list of finite numbers"),
    ],
)
def test_what_is_wrong_is_named(knee, call, message):
    with pytest.raises(InputError, match=message):
        call(knee)
