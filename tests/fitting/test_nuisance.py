"""What a twin lacks is fitted as nuisance: which parameters, with which priors, and the effect on requested ones."""

from __future__ import annotations

from dataclasses import asdict, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import small_scene

import fitting
import pftwin
from fitting.coverage import QUICK_WITH_NUISANCE
from fitting.estimate import Estimate
from fitting.nuisance import SLIP_SPEED, Nuisance
from fitting.parameters import Applied, free_parameters
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.spatial import Quaternion
from pftwin.geometry.wrapping.cylinder import Cylinder
from pftwin.geometry.wrapping.ellipsoid import Ellipsoid
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.friction import Friction
from pftwin.model.effects.tendon import Tendon
from pftwin.model.measured import Measured
from pftwin.model.scene import Scene
from pftwin.rig.retinacula import with_retinacula

COEFFICIENT = "contact.friction.coefficient"
ENDS = [f"{t}.{end}.{a}" for t in ("quadriceps", "patellar_tendon") for end in ("insertion", "origin") for a in "xyz"]
NOISE, FORCE_NOISE = 2e-5, 0.05  # [m], [N]


def rough(scene: Scene, coefficient: float) -> Scene:
    contact = scene.contact
    assert contact is not None
    made = contact.with_friction(Friction(jnp.asarray(coefficient), jnp.asarray(SLIP_SPEED)))
    return replace(scene, effects=tuple(made if e is contact else e for e in scene.effects))


def test_attachments_are_the_ends_of_all_tendons_within_four_deviations():
    found = Nuisance(attachments=5e-4).numbers(small_scene())
    assert sorted(found.names) == sorted(ENDS)
    assert found.priors["quadriceps.origin.y"] == (pytest.approx(0.006), 5e-4)
    assert found.bounds["quadriceps.origin.y"] == pytest.approx((0.004, 0.008))


def test_what_a_line_runs_over_is_no_attachment():
    scene = small_scene()
    (band,) = (e for e in scene.effects if e.name == "quadriceps")
    cylinder = Cylinder(vector([0.05, 0.0, 0.01]), "femur", number(0.02), vector([0.0, 1.0, 0.0]))
    wrapped = scene.with_effect(eqx.tree_at(lambda t: t.wrap, band, cylinder, is_leaf=lambda x: x is None))
    assert sorted(Nuisance(attachments=5e-4).numbers(wrapped).names) == sorted(ENDS)


def test_an_obstacle_on_the_patella_shifts_with_the_insertion():
    """An insertion that moved alone would come to lie inside it."""
    scene = small_scene()
    (band,) = (e for e in scene.effects if e.name == "patellar_tendon")
    assert isinstance(band, Tendon)
    ellipsoid = Ellipsoid(
        band.insertion + vector([0.007, 0.001, 0.002]),
        "patella",
        vector([0.005, 0.008, 0.006]),
        Quaternion.from_array(jnp.asarray([1.0, 0.0, 0.0, 0.0])),
    )
    wrapped = scene.with_effect(eqx.tree_at(lambda t: t.wrap, band, ellipsoid, is_leaf=lambda x: x is None))
    found = Nuisance(attachments=5e-4).numbers(wrapped)
    along = "patellar_tendon.insertion.x~patellar_tendon.wrap.center.x"
    assert sorted(n for n in found.names if "~" in n) == [along, along.replace(".x", ".y"), along.replace(".x", ".z")]
    assert len(found.names) == len(ENDS)
    farthest = wrapped.set(along, found.bounds[along][1])
    ends = [(s.get("patellar_tendon.insertion.x"), s.get("patellar_tendon.wrap.center.x")) for s in (wrapped, farthest)]
    np.testing.assert_allclose(np.diff(ends, axis=0), [[2e-3, 2e-3]], rtol=1e-12)


def test_damping_is_relative_and_what_is_not_damped_stays_so():
    scene = small_scene().with_effect(LinearDamping(number(2.0), number(0.0)))
    found = Nuisance(damping=0.3).numbers(scene)
    deviations = {"quadriceps.damping": 0.3 * 1.56, "patellar_tendon.damping": 0.3 * 6.29, "damping.translational": 0.6}
    assert {name: sd for name, (_, sd) in found.priors.items()} == pytest.approx(deviations)
    assert found.bounds["damping.translational"] == pytest.approx((0.0, 2.0 + 4 * 0.6))


def test_friction_begins_at_the_scenes_or_at_what_is_published():
    nuisance = Nuisance(friction=0.01)
    made = nuisance.prepared(small_scene())
    assert float(made.get(COEFFICIENT)) == 0.05
    assert nuisance.numbers(made).priors == {COEFFICIENT: (0.05, 0.01)}
    own = rough(small_scene(), 0.02)
    assert nuisance.prepared(own) is own
    assert nuisance.numbers(own) == (
        (COEFFICIENT,),
        {COEFFICIENT: (0.0, pytest.approx(0.06))},
        {COEFFICIENT: (0.02, 0.01)},
        {COEFFICIENT: "friction"},
    )


def test_what_is_asked_for_by_name_is_not_asked_for_twice():
    found = Nuisance(attachments=5e-4, friction=0.01).numbers(rough(small_scene(), 0.02), but=(COEFFICIENT, ENDS[3]))
    assert sorted(found.names) == sorted(set(ENDS) - {ENDS[3]})


def test_any_other_number_has_a_deviation_of_its_own_and_stays_what_it_can_be():
    scene = small_scene()
    others = {
        "patella.mass": 0.05,
        "contact.surface.coefficients[3]": 2e-4,
        "K2": 30.0,
        "patellar_tendon.origin.x": 4e-3,
    }
    found = Nuisance(attachments=1e-3, others=others).numbers(scene, but=(ENDS[-2],))
    mass, third = (float(scene.get(name)) for name in ("patella.mass", "contact.surface.coefficients[3]"))
    origin = float(scene.get("patellar_tendon.origin.x"))
    assert sorted(found.names) == sorted({*ENDS, *others, "patellar_tendon.stiffness"} - {"K2", ENDS[-2]})
    assert found.priors["patella.mass"] == (pytest.approx(mass), 0.05)
    assert found.bounds["patella.mass"] == pytest.approx((1e-3 * mass, mass + 0.2))
    assert found.bounds["contact.surface.coefficients[3]"] == pytest.approx((third - 8e-4, third + 8e-4))
    assert found.priors["patellar_tendon.stiffness"] == (pytest.approx(629.0), 30.0)
    assert found.priors["patellar_tendon.origin.x"] == (pytest.approx(origin), 4e-3)
    assert found.kinds["patellar_tendon.origin.x"] == found.kinds["patella.mass"] == "others"
    assert found.kinds["quadriceps.origin.x"] == "attachments"
    with pytest.raises(InputError, match=r"no parameter .graft"):
        Nuisance(others={"graft.toe_strain": 0.01}).numbers(scene)


def test_texts_of_the_command_line():
    assert Nuisance.of("rig") == Nuisance(attachments=1e-3, friction=0.05, damping=0.5, stiffening=0.1)
    assert [Nuisance.of(name).attachments for name in ("mocap", "mri")] == [5e-3, 2e-3]
    assert Nuisance.of("friction=0.03, attachments=1e-3") == Nuisance(friction=0.03, attachments=1e-3)
    assert Nuisance.of(None) == Nuisance()
    more = Nuisance.of("mri,graft.toe_strain=0.01,damping=0.2,patella.mass=0.005")
    assert more == replace(Nuisance.of("mri"), damping=0.2, others={"graft.toe_strain": 0.01, "patella.mass": 0.005})
    assert Nuisance(**asdict(more)) == more


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("ring", "found 'ring'; expected: one of: rig, mocap, mri"),
        ("friktion=0.1", "found 'friktion'"),
        ("friction", "found 'friction'; expected: one of: rig"),
        ("friction=0.1,friction=0.2", "found 'friction'; .*; each once"),
        ("friction=much", "found 'friction=much'"),
        ("friction=-0.1", "friction: found -0.1; expected: a standard deviation, or 0"),
        ("damping=nan", "damping: found nan"),
        ("graft.toe_strain=-1", "graft.toe_strain: found -1.0"),
        ("graft.toe_strain=1,graft.toe_strain=2", "found 'graft.toe_strain'; .*; each once"),
    ],
)
def test_what_is_no_nuisance_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        Nuisance.of(given)


def test_friction_needs_a_contact():
    with pytest.raises(InputError, match="friction without a contact"):
        Nuisance(friction=0.05).prepared(small_scene().without("contact"))


def test_the_papers_objective_has_nothing_to_weigh_it_by():
    with pytest.raises(InputError, match="no noise to weigh priors against"):
        fitting.fit_tendons(small_scene(), pftwin.rig.measured(1), objective="paper", nuisance="rig")


def test_searches_begin_within_what_is_known():
    free = free_parameters(small_scene(), ("K1", "L1"), 0.2, {"L1": (0.1432, 1e-3)})
    found = free.scattered(400, np.random.default_rng(2))
    assert np.ptp(free.share(found)[:, 0]) > 0.99
    assert found[:, 1].mean() == pytest.approx(0.1432, abs=2e-4)
    assert found[:, 1].std() == pytest.approx(1e-3, rel=0.1)


def test_searches_of_what_cannot_be_negative_begin_off_its_bound():
    """At a bound the map to unbounded parameters is flat, and the search would stand still."""
    made = Nuisance(friction=0.05).prepared(small_scene())
    free = free_parameters(made, (COEFFICIENT,), {COEFFICIENT: (0.0, 0.25)}, {COEFFICIENT: (0.05, 0.05)})
    share = free.share(free.scattered(1000, np.random.default_rng(0)))
    assert share.min() > 0
    assert share.max() < 1
    assert np.median(free.scattered(4000, np.random.default_rng(1))) == pytest.approx(0.0600, abs=2e-3)


def test_strands_of_a_ligament_shift_together():
    scene = with_retinacula(pftwin.rig.case(1))
    found = Nuisance(attachments=5e-4).numbers(scene)
    groups = [e.name for e in scene.effects if (line := e.line_element()) is not None and line.count is not None]
    assert groups
    for group in groups:
        ends = [f"{group}.{end}.{axis}[:]" for end in ("insertion", "origin") for axis in "xyz"]
        assert sorted(name for name in found.names if name.startswith(f"{group}.")) == ends


def test_an_estimate_gives_other_scenes_what_they_lack():
    applied = Applied(("K1", COEFFICIENT), np.array([170.0, 0.03]), nuisance=Nuisance(friction=0.05))
    made = applied(small_scene())
    assert float(made.get(COEFFICIENT)) == 0.03
    assert float(made.get("K1")) == 170.0


def knee_with(friction: float, origin: float) -> tuple[Scene, Measured]:
    """The small knee, and what is measured of it where it has friction and the quadriceps starts elsewhere."""
    scene = small_scene(21)
    true = rough(scene, friction).set("K1", 150.0).set("quadriceps.origin.y", origin)
    # In shorter steps than those in which fits end, which are halved until they tell the same.
    found = pftwin.simulate(true, integrator=pftwin.LinearImplicit(), dt=1e-2 / 96)
    random = np.random.default_rng(4)
    center = found.center + NOISE * random.standard_normal(found.center.shape)
    tension = found.tensions["quadriceps"] + FORCE_NOISE * random.standard_normal(found.times.size)
    return scene, Measured(scene.motion.times, center, femoral_spring_force=tension)


def fitted(knee: tuple[Scene, Measured], nuisance: Nuisance | None) -> Estimate:
    known = {"position": NOISE, "quadriceps": FORCE_NOISE}
    return fitting.fit_tendons(*knee, free=("K1", "L1"), use="all", noise=known, nuisance=nuisance, starts=4)


@pytest.mark.slow
def test_an_estimate_speaks_of_what_was_asked_for(tmp_path):
    found = fitted(knee_with(0.03, 0.006), Nuisance(friction=0.05))
    assert (found.names, found.auxiliary) == (("K1", "L1", COEFFICIENT), (COEFFICIENT,))
    assert np.all(np.abs(found.values - [150.0, 0.1432, 0.03]) < 2.5 * found.standard_deviations)
    assert "friction" not in found.sentence()
    assert QUICK_WITH_NUISANCE.intervals in found.sentence()
    assert "nuisance and differences between trials:\n  contact.friction.coefficient 0.0" in found.summary()
    again = Estimate.load(found.save(tmp_path / "fit.json"), small_scene(21))
    assert (again.auxiliary, again.nuisance) == (found.auxiliary, found.nuisance)
    assert float(again.scene.get(COEFFICIENT)) == pytest.approx(found.values[2])


@pytest.mark.slow
def test_what_the_twin_lacks_does_not_go_into_what_is_asked_for():
    knee = knee_with(0.03, 0.0072)
    exact, open_ = (fitted(knee, nuisance) for nuisance in (None, Nuisance(attachments=1e-3, friction=0.05)))
    assert set(open_.auxiliary) == {COEFFICIENT, *ENDS}
    assert exact.at_bounds == ("K1",)  # a third too stiff
    assert exact.rmse["position"] > 2 * NOISE
    assert abs(open_.values[0] - 150.0) < 2.5 * open_.standard_deviations[0]
    assert open_.rmse["position"] < 1.3 * NOISE
    friction = open_.names.index(COEFFICIENT)
    assert abs(open_.values[friction] - 0.03) < 2.5 * open_.standard_deviations[friction]


@pytest.mark.slow
def test_a_plan_knows_less_of_a_twin_that_is_not_exact(monkeypatch):
    """As the whole covariance's block says, by inverting all of it; in equal steps, whose halving depends on what is
    asked for."""
    monkeypatch.setattr("fitting.identifiability.shorten_steps", lambda *_: 0.0)
    nuisance, use = Nuisance(friction=0.05, damping=0.5), ("position", "quadriceps")
    exact, open_ = (
        fitting.plan_experiment(small_scene(21), use=use, nuisance=n, candidates=()) for n in (None, nuisance)
    )
    assert open_.names == exact.names == ("K1", "L1", "K2", "L2")
    assert (open_.relative > exact.relative).all()
    made = nuisance.prepared(small_scene(21))
    numbers = nuisance.numbers(made)
    all_of_it = fitting.plan_experiment(
        made,
        free=(*exact.names, *numbers.names),
        use=use,
        candidates=(),
        bounds=dict.fromkeys(exact.names, 0.3) | numbers.bounds,
        priors=numbers.priors,
    )
    np.testing.assert_allclose(open_.covariance, all_of_it.covariance[:4, :4], rtol=1e-6)
