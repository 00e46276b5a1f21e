"""Two facets that partly bear one contact, in single precision."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import vec

from pftwin.base.spatial import Vec3
from pftwin.geometry.contact.ball_cut import BallCut
from pftwin.geometry.contact.overlap import _out_of_power, overlap
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


@pytest.mark.parametrize("depth", [1e-6, 2e-4, 1e-3])
def test_indentations_by_their_power(depth):
    """The power of a point d deep in a sphere is d (1 - d / 2 R); behind the surface the way out is 2 R - d."""
    radius = 0.022
    power = jnp.asarray(depth * (1 - depth / (2 * radius)))
    for behind, wanted, sign in ((False, depth, 1), (True, 2 * radius - depth, -1)):
        found, slope = _out_of_power(power, jnp.asarray(radius), jnp.asarray(behind))
        assert float(found) == pytest.approx(wanted, rel=1e-5)
        assert float(slope) == pytest.approx(sign / (1 - depth / radius), rel=1e-4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_share_of_one_contact_changes_as_its_slope_says(axis):
    """Facets of unlike volume; 2 R V changes by twice the moment, the seam's integrals by their slopes."""
    x = jnp.asarray
    cuts = [
        BallCut(x(6.2e-7), x(doubled), vec(*moment), x(-1.4e-8))
        for doubled, moment in ((8.5e-14, (3e-10, -2e-10, -1.4e-8)), (5.5e-14, (-1e-10, 2.5e-10, -1.1e-8)))
    ]
    depth, square = vec(2e-5, -3e-5, -8.8e-4), vec(1e-10, 3e-10, -5.2e-9)
    seam, r = SeamDepth(x(8.8e-4), x(2.6e-9), x(9.2e-15), depth, square), x(0.022)

    def at(h):
        moved = [c._replace(doubled=c.doubled + 2 * h * c.moment.array()[axis]) for c in cuts]
        along = {"depth": seam.depth + h * depth.array()[axis], "square": seam.square + h * square.array()[axis]}
        return overlap(Patch(PatchSums((moved[0], moved[1]), seam._replace(**along)), jnp.asarray(False)), r, r)

    here, h = at(0.0), 1e-10
    assert 0.05 < float(here.merged) < 0.95
    assert float(here.merged_slope.array()[axis]) == pytest.approx(
        float(at(h).merged - at(-h).merged) / (2 * h), rel=1e-5
    )
