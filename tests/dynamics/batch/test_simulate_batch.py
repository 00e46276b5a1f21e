"""A batch is what `simulate` gives of each scene; bad members are done again and marked, bad input is refused."""

from __future__ import annotations

import dataclasses
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from batch_checks import bent, bits, rows_of
from small_scene import small_scene

import pftwin
from pftwin import Variants, simulate_batch
from pftwin.base.errors import InputError
from pftwin.dynamics.batch import plan as again
from pftwin.dynamics.batch.batched import FEW, PIECE, Sharding, piece_for
from pftwin.dynamics.integrators import SymplecticEuler

FRAMES, DT, COUNT = 6, 5e-3, 5


def quick(scene, seen):
    return {"first_force": seen.effects["contact"]["force"][0]}


@cache
def small():
    return small_scene(FRAMES)


def batch(rows, **more):
    return simulate_batch(Variants(small(), bent, rows), dt=DT, devices=1, trajectories=True, outcome=quick, **more)


@cache
def five():
    return batch(rows_of(COUNT))


def test_each_member_is_what_simulate_gives():
    for i, row in enumerate(rows_of(COUNT)[:2]):
        alone = pftwin.simulate(bent(small(), jnp.asarray(row)), dt=DT)
        np.testing.assert_allclose(five()["sphere_center"].values[i], alone.center, atol=1e-12)
        np.testing.assert_allclose(five()["first_force"].values[i], alone.effects["contact"]["force"][0], rtol=1e-7)
        assert five()["status"].values[i] == int(np.bitwise_or.reduce(alone.flags))
        for name, largest in alone.error.largest.items():
            assert five()[f"estimated_error_{name}"].values[i] == pytest.approx(largest, rel=1e-6, abs=1e-9)
        assert five()["start_shift"].values[i] == pytest.approx(alone.equilibrium.moved, rel=1e-9)
        assert five()["start_turn"].values[i] == pytest.approx(np.degrees(alone.equilibrium.turned), rel=1e-9)


@pytest.mark.slow
def test_a_list_of_scenes_is_a_batch_in_its_order():
    rows = rows_of(COUNT)
    scenes = [dataclasses.replace(bent(small(), jnp.asarray(row)), name=f"knee {i}") for i, row in enumerate(rows)]
    scenes[3] = dataclasses.replace(bent(small_scene(FRAMES - 1), jnp.asarray(rows[3])), name="short")
    found = simulate_batch(scenes, dt=DT, devices=1)
    assert found["scene"].values.tolist() == ["knee 0", "knee 1", "knee 2", "short", "knee 4"]
    others = [0, 1, 2, 4]
    np.testing.assert_allclose(found["mean_tilt"].values[others], five()["mean_tilt"].values[others], rtol=1e-9)
    assert found["mean_tilt"].values[3] != five()["mean_tilt"].values[3]
    assert "sphere_center" not in found
    with pytest.raises(InputError, match="trajectories: scenes of different recorded times; try: a batch for each"):
        simulate_batch(scenes, dt=DT, trajectories=True)


@pytest.mark.slow
def test_chunks_change_no_bit():
    calls = []
    rows = rows_of(2 * FEW)
    whole = batch(rows)
    assert bits(batch(rows, chunk=1, progress=lambda *a: calls.append(a))) == bits(whole)
    assert calls == [(FEW, 2 * FEW), (2 * FEW, 2 * FEW)]


@pytest.mark.slow
def test_parts_change_no_bit(monkeypatch, tmp_path):
    monkeypatch.setattr("pftwin.dynamics.batch.simulate_batch._LEAST", FEW)  # members of a part
    whole = batch(rows_of(2 * FEW))
    assert batch(rows_of(2 * FEW), parts=tmp_path).identical(whole)
    (tmp_path / "part_00001.nc").unlink()
    calls = []
    again = batch(rows_of(2 * FEW), parts=tmp_path, progress=lambda *a: calls.append(a))
    assert bits(again) == bits(whole)
    assert calls == [(FEW, FEW)]
    with pytest.raises(InputError, match="holds parts of another batch, with other program; expected"):
        simulate_batch(Variants(small(), bent, rows_of(2 * FEW)), dt=DT, devices=1, trajectories=True, parts=tmp_path)


@pytest.mark.slow
def test_a_bad_member_is_recomputed_and_the_others_do_not_change():
    """One tendon is so stiff that the explicit step is too long for it alone."""
    rows, mates = rows_of(COUNT), [0, 1, 3, 4]
    rows[2, 0] = 1e5

    def by_explicit_steps(care):
        many = Variants(small_scene(12), bent, rows)
        return simulate_batch(many, dt=1.25e-4, devices=1, integrator=SymplecticEuler(), care=care)

    before, after = by_explicit_steps(False), by_explicit_steps(True)
    bad = sum(int(f) for f in again.BAD)
    assert before["status"].values[2] & bad
    assert not (before["status"].values[mates] & bad).any()
    assert after["recomputed"].values.tolist() == [0, 0, again.WAYS.index("smaller_step"), 0, 0]
    assert not after["status"].values[2] & bad
    del before["recomputed"], after["recomputed"]
    assert bits(after, mates) == bits(before, mates)


@pytest.mark.slow
def test_members_with_large_errors_are_recomputed_unless_the_step_was_given():
    """A contact a hundred thousand times as stiff as usual, tendons without damping: 1 ms is too long for it."""
    scene = small_scene(31).set("quadriceps.damping", 0.0).set("patellar_tendon.damping", 0.0)
    rows = np.array([[1.0], [1e5]])

    def stiffer(scene, row):
        button = scene.contact
        return scene.with_effect(eqx.tree_at(lambda e: e.law.contact_stiffness, button, 2e8 * row[0]))

    large = int(pftwin.Status.INACCURATE)
    asked, free = (simulate_batch(Variants(scene, stiffer, rows), devices=1, **dt) for dt in ({"dt": 1e-3}, {}))
    assert (asked["status"].values & large).tolist() == [0, large]
    shorter = again.WAYS.index("smaller_step")
    assert shorter not in asked["recomputed"].values
    assert free["recomputed"].values.tolist() == [0, shorter]
    assert not (free["status"].values & large).any()
    assert free["estimated_error_contact_force"].values[1] < asked["estimated_error_contact_force"].values[1]
    unsaid = simulate_batch(Variants(scene, stiffer, rows), devices=1, dt=1e-3, estimate=False)
    assert "estimated_error_path" not in unsaid
    assert not (unsaid["status"].values & large).any()


@pytest.mark.slow
def test_too_long_a_step_is_shortened():
    """At 10 ms the step is too long for a stiff tendon's patella; a quarter of it is not."""
    rows = rows_of(COUNT)
    rough = simulate_batch(Variants(small(), bent, rows), dt=1e-2, devices=1, care=False, integrator=SymplecticEuler())
    found = simulate_batch(Variants(small(), bent, rows), dt=1e-2, devices=1, integrator=SymplecticEuler())
    bad = sum(int(f) for f in again.BAD)
    assert (rough["status"].values & bad).all()
    assert not (found["status"].values & bad).any()
    assert (found["recomputed"].values > 0).all()
    assert found.attrs["recomputed_members"] == COUNT


def test_a_member_that_makes_no_sense_is_marked():
    rows = rows_of(COUNT)
    rows[1, 0] = -5.0
    found = batch(rows)
    assert found["failed"].values.tolist() == [False, True, False, False, False]
    for name in ("mean_tilt", "sphere_center", "patella_position"):  # summary and courses
        assert np.isnan(found[name].values[1]).all()
        assert np.isfinite(found[name].values[0]).all()
    assert found["recomputed"].values[1] == 0
    others = [0, 2, 3, 4]
    assert bits(found, others) == bits(five(), others)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: simulate_batch([]), "scenes: nothing to simulate; expected: at least one scene"),
        (lambda: simulate_batch(small()), r"scenes: found a single scene; expected: a list.*try: pftwin\.simulate"),
        (lambda: simulate_batch("case 2"), "scenes: found 'case 2'; expected: a list of scenes, or Variants"),
        (lambda: simulate_batch([small(), 3]), r"scenes\[1\]: found 3; expected: a scene"),
        (lambda: batch(np.zeros(3)), r"values: found an array of shape \(3,\); expected: \(n, k\) finite"),
        (lambda: batch(np.full((2, 2), np.nan)), r"shape \(2, 2\), not all finite"),
        (lambda: simulate_batch(Variants(small(), 3, [[1.0]])), r"Variants\.change: found 3; expected: a function"),
        (lambda: simulate_batch(Variants(small(), lambda s, r: r, [[1.0]])), "change: gives .*; expected: a scene"),
        (lambda: simulate_batch(Variants("knee", bent, [[1.0]])), r"Variants\.scene: found 'knee'"),
        (lambda: batch(rows_of(2), chunk=0), "chunk: found 0; expected: a whole number, at least 1"),
        (lambda: simulate_batch([small()], dt=1e-3, tolerance="0.1 mm"), "simulate_batch: found both dt and tolerance"),
        (lambda: simulate_batch([small()], dt=0.0), r"dt: found 0\.0; expected: a positive"),
        (lambda: simulate_batch([small()], integrator="magic"), "magic"),
        (lambda: simulate_batch([small()], devices=0), 'devices: found 0; expected: "all", a number'),
        (lambda: simulate_batch([small()], devices=[]), r"devices: found \[\]"),
        (lambda: simulate_batch([small()], devices=jax.devices() * 2), "one device is named twice"),
        (lambda: simulate_batch([small()], devices=99), r"devices: found 99, where JAX has \d+ cpu device\(s\)"),
    ],
)
def test_refusals(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (lambda scene, seen: {"status": seen.status[0]}, "outcome: found 'status'; expected: names that the batch"),
        pytest.param(
            lambda scene, seen: {"time": seen.status[0]},
            "outcome: found 'time'; expected: names that the batch",
            marks=pytest.mark.slow,
        ),
        (lambda scene, seen: seen.status[0], "outcome: gives .*; expected: a dictionary of numbers or arrays"),
        pytest.param(
            lambda scene, seen: {"name": "knee"},
            "outcome: found 'name'; expected: names with numbers or arrays",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_outcomes_that_cannot_be_stored_are_refused_before_anything_runs(outcome, words, monkeypatch):
    monkeypatch.setattr("pftwin.dynamics.batch.plan.all_members", None)
    with pytest.raises(InputError, match=words):
        simulate_batch(Variants(small(), bent, rows_of(1)), dt=DT, devices=1, outcome=outcome)


@pytest.mark.parametrize("n", [1, 119, 120, 121, 241, 5000])
@pytest.mark.parametrize("chunk", [1, 120, 500])
def test_every_member_has_a_place(n, chunk):
    spread = Sharding(tuple(jax.devices()[:1]), PIECE, chunk)
    chunks = list(spread.chunks(n))
    places = np.concatenate([c.rows[c.used].ravel()[: c.members] for c in chunks])
    np.testing.assert_array_equal(places, np.arange(n))
    assert max(c.rows.size for c in chunks) <= max(chunk, PIECE)
    assert sum(c.counts.sum() for c in chunks) == -(-n // PIECE)


def test_a_function_is_traced_once():
    """Tracing is most of what the start of a process takes once its programs are kept."""
    traced = []

    def doubled(factor, row):
        traced.append(row.shape)
        return {"double": factor * row}

    spread = Sharding(tuple(jax.devices()[:1]), FEW, 2 * FEW)
    rows = np.arange(FEW + 3.0)
    (chunk,) = spread.chunks(len(rows))
    found = spread.run(doubled, spread.shared(jnp.asarray(2.0)), chunk, spread.placed((rows,), chunk))
    np.testing.assert_array_equal(spread.taken(found, chunk)["double"], 2 * rows)
    assert traced == [()]


def test_pieces_are_of_few_sizes():
    assert {piece_for(n, "cpu") for n in range(1, 2000)} == {FEW, PIECE}
    assert {piece_for(n, "gpu") for n in (1, 100, 10**6)} == {16, 128, 131_072}
