"""What is absent is not imported, and what others have changes nothing, to the last bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import knee, settled, tendon
from test_variants import hung

from pftwin.dynamics.frame_states import frame_states
from pftwin.model.effects.base import Effect, Load

ANALYTIC = """
import sys
import equinox as eqx
from scenes import knee
from pftwin.dynamics.observe import observe
from pftwin.dynamics.frame_states import frame_states
scene = knee(5)
eqx.filter_eval_shape(lambda s: observe(s, frame_states(s, substeps=2)), scene)
print([m for m in sys.modules if m.startswith("pftwin") and any(w in m for w in (WORDS))])
"""


def loaded(*words: str) -> str:
    root = Path(__file__).resolve().parents[3]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), str(root / "tests")])}
    code = ANALYTIC.replace("WORDS", repr(words))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env)
    return done.stdout.strip()


@pytest.mark.slow
def test_a_scene_without_meshes_imports_no_search_and_no_effect_that_it_lacks():
    absent = "bvh", "mesh_contact", "elastic_foundation", "viscoelastic", "audit"
    assert loaded(*absent) == "[]"
    assert "sphere_contact" in loaded("sphere_contact")


def run(scene, start) -> list[np.ndarray]:
    """Through a program traced for this call alone."""
    arrays, fixed = eqx.partition(scene, eqx.is_array)
    states = jax.jit(lambda a, s: frame_states(eqx.combine(a, fixed), substeps=2, start=s).states)(arrays, start)
    return [np.asarray(a) for a in jax.tree.leaves(states)]


@pytest.mark.slow
def test_what_other_scenes_have_changes_no_bit():
    scene = knee(7)
    start = settled(scene)
    before = run(scene, start)
    other = scene.with_effect(tendon(slack=0.01, body="femur", name="other"))
    unlike = run(other, settled(other))

    class Elsewhere(Effect):
        """Of a module that this scene knows nothing of."""

        def load(self, now, memory):
            return Load(energy=jnp.zeros(())), memory

    assert Elsewhere(name="elsewhere").name == "elsewhere"
    import pftwin.files.scene_file.registry
    import pftwin.model.effects.elastic_foundation  # noqa: F401

    assert np.isfinite(before[0]).all()
    assert not np.array_equal(before[0], unlike[0])
    after = run(other.without("other"), start)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("make", [hung, pytest.param(lambda: knee(7), marks=pytest.mark.slow)], ids=["tendons", "knee"])
def test_a_member_of_a_batch_is_what_it_is_beside_others(make):
    scene = make()
    start = settled(scene)

    def path(softer):
        changed = eqx.tree_at(lambda s: s.effects[2].stiffness, scene, softer)
        return frame_states(changed, substeps=2, start=start).states.position

    batch = jax.jit(jax.vmap(path))
    k = scene.effects[2].stiffness
    ours, others = batch(jnp.stack([k, k, 0.5 * k])), batch(jnp.stack([k, 2 * k, 0.9 * k]))
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(others), strict=True):
        assert np.array_equal(a[0], b[0])
        assert not np.array_equal(a[1], b[1])
