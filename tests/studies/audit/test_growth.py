"""A scene's step grows by what is added and by nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import knee, look, tendon

from pftwin.model.effects.damping import LinearDamping
from pftwin.model.scene import Scene
from pftwin.studies.audit.account import equations
from tests.benchmarks import growth


def whole() -> Scene:
    scene = knee(5)
    zero = scene.patella.mass * 0
    return scene.with_effect(LinearDamping(zero + 0.5, zero + 2e-4, body="femur"))


@pytest.fixture(scope="module")
def counts() -> list[int]:
    return [equations(scene) for scene in growth._growing(whole()).values()]


def test_every_effect_adds_equations_and_contact_most(counts):
    weight, one, two, strung, touching, damped = counts
    added = np.diff(counts)
    assert (added > 0).all()
    assert touching - strung == added.max()
    assert damped - touching < 100
    assert two - one < 1.2 * (one - weight)


def test_thirty_strands_add_what_a_tendon_adds(counts):
    """One effect over a leading axis, not thirty."""
    weight, one, _, strung, *_ = counts
    assert strung - counts[2] < 1.5 * (one - weight)


def test_an_effect_adds_the_same_to_a_larger_scene():
    small, large = whole().without("contact"), whole()
    added = [
        equations(s.with_effect(tendon(body="femur", name="more"))) - equations(s.without("quadriceps").with_effect(
            tendon(body="femur", name="more")
        ))
        for s in (small, large)
    ]  # fmt: skip
    assert abs(added[0] - added[1]) < 0.5 * max(added)


def test_strands_are_thirty_and_pull_like_the_retinacula():
    from pftwin.rig import with_retinacula

    scene = whole()
    group = growth.strands(scene)
    assert group.stiffness.shape == (growth.STRANDS,)
    at = look(position=(0.0, 0.03, 0.08))
    pulls = [
        np.asarray(e.load(at, None)[0].total().force.array())
        for e in (group, *(e for e in with_retinacula(scene).effects if e.name in ("mpfl", "lpfl")))
    ]
    assert np.linalg.norm(pulls[0]) > 0
    np.testing.assert_allclose(pulls[0], pulls[1] + pulls[2], atol=1e-9)
