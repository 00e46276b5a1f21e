"""Two facets that partly bear one contact, in single precision."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pftwin.base.spatial import Vec3
from pftwin.geometry.contact.ball_cut import BallCut
from pftwin.geometry.contact.overlap import overlap
from pftwin.geometry.contact.patch_mesh import SeamDepth
from pftwin.geometry.contact.sphere_patch import Patch, PatchSums


@pytest.mark.parametrize("share", [1.0, 1e-2, 1e-4], ids=["5_um", "50_nm", "half_a_nm"])
def test_a_light_contact_has_derivatives_in_single_precision(share):
    """The fourth power of an indentation's square has no inverse in float32; 50 nm deep, its square has none either."""

    def x(value: float, power: float = 0.0) -> jax.Array:
        return jnp.float32(value * share**power)

    cuts = [
        BallCut(x(6.2e-7, 1), x(8.5e-14, 2), Vec3(x(0), x(y, 2), x(-1.37e-8, 1)), x(-1.37e-8, 1))
        for y in (-2e-10, 2e-10)
    ]
    slopes = Vec3(x(0), x(0), x(-8.8e-4, 0.5)), Vec3(x(0), x(0), x(-5.2e-9, 1.5))
    seam = SeamDepth(x(8.8e-4, 0.5), x(2.6e-9, 1.5), x(9.2e-15, 2.5), *slopes)
    patch = Patch(PatchSums((cuts[0], cuts[1]), seam), jnp.asarray(False))
    slope, change = jax.jvp(
        lambda p: overlap(patch._replace(sums=p), x(0.022), x(0.022)).merged_slope.z, (patch.sums,), (patch.sums,)
    )
    assert slope < 0
    assert np.isfinite(change)
