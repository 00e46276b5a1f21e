"""A fit's trial parameters are laid over devices, and its course is the same to rounding."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from elsewhere import elsewhere
from jax.sharding import Mesh
from lifted_fits import SPRINGS
from small_scene import small_scene

import fitting
from fitting import programs
from pftwin.base import cache_folder
from pftwin.base.errors import InputError
from pftwin.dynamics.batch.batched import AXIS
from pftwin.model.measured import Measured


@pytest.mark.parametrize("program", ["predictions", "with_slopes"])
@pytest.mark.slow
def test_variants_that_are_laid_out_give_the_same(program):
    """Over one device: what `shard_map` makes of the programs."""
    scene = small_scene(6)
    p = fitting.free_parameters(scene, SPRINGS)
    theta = jnp.asarray(p.nominal * np.linspace(0.95, 1.05, 3)[:, None])
    guesses = jax.tree.map(lambda a: jnp.broadcast_to(a, (3,)), scene.start)
    alone = programs.FitProgram(p.places, ("position", "quadriceps"), None)
    laid = alone._replace(mesh=Mesh(np.array(jax.local_devices()[:1]), (AXIS,)))
    run = getattr(programs, program)
    both = [jax.tree.leaves(run(one, scene.unnamed(), jnp.asarray(2), theta, guesses)) for one in (alone, laid)]
    for a, b in zip(*both, strict=True):
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
    assert both[0][0].shape == (3, 6, 4)
    if program == "with_slopes":
        slopes = both[0][-1]
        assert slopes.shape == (4, 3, 6, 4)
        assert np.abs(slopes).max(axis=(1, 2, 3)).min() > 0


def test_a_device_that_is_not_there_is_refused():
    scene = small_scene(6)
    measured = Measured(scene.motion.times, np.zeros((6, 3)))
    with pytest.raises(InputError, match="devices: found 99, where JAX has"):
        fitting.fit_tendons(scene, measured, devices=99)


@pytest.mark.slow
def test_two_devices_find_what_one_finds():
    checks = Path(__file__).with_name("fit_device_checks.py")
    done = elsewhere(str(checks), str(cache_folder.chosen()))
    assert done.returncode == 0, done.stderr[-2000:]
    for method, (one, two) in json.loads(done.stdout.splitlines()[-1]).items():
        np.testing.assert_allclose(two["values"], one["values"], rtol=1e-6, err_msg=method)
        assert two["iterations"] == one["iterations"], method
