"""Two facets that partly bear one contact, in single precision."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.spatial import Vec3
from pftwin.surfaces.ball_cut import BallCut
from pftwin.surfaces.overlap import overlap
from pftwin.surfaces.seam import SeamDepth
from pftwin.surfaces.sphere_patch import Patch, PatchSums


def test_a_light_contact_has_derivatives_in_single_precision():
    """Some 5 um deep: the fourth power of an indentation's square has no inverse in float32."""
    x = jnp.float32
    cuts = [BallCut(x(6.2e-7), x(8.5e-14), Vec3(x(0), x(y), x(-1.37e-8)), x(-1.37e-8)) for y in (-2e-10, 2e-10)]
    seam = SeamDepth(x(8.8e-4), x(2.6e-9), x(9.2e-15), Vec3(x(0), x(0), x(-8.8e-4)), Vec3(x(0), x(0), x(-5.2e-9)))
    patch = Patch(PatchSums((cuts[0], cuts[1]), seam), jnp.asarray(False))
    slope, change = jax.jvp(
        lambda p: overlap(patch._replace(sums=p), x(0.022), x(0.022)).merged_slope.z, (patch.sums,), (patch.sums,)
    )
    assert slope < 0
    assert np.isfinite(change)
