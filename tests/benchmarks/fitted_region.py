"""What the region that the rig's patches are fitted to is worth: `python -m tests.benchmarks.fitted_region`.

The table of docs/accuracy.md, "The region of the fit": fits of the same mesh to several regions, judged by the true
surface, where the button tracks and where it slides when dislocated, and by the paths that it takes on them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.geometry.patch.implant import RIG_ANGLES, RIG_HALF_WIDTH, RIG_PARTS, RIG_RIM, RIG_TOLERANCE, rig_implant

TRUE = rig_implant()
TRACKS = (-66, 38), (-14, 15)  # where the button touches the true surface while it tracks [deg, mm]
SLIDES = (-10, 38), (12, 21.5)  # and when it has dislocated, before the knee bends again
FLANK = (-10, 38), (12, 31.9)  # to the rim
OLD = np.radians((-75.0, 30.0))
REGIONS = {  # angles [rad], half width [m], weights
    "to 30 deg, 20 mm, all alike": (tuple(OLD), 20e-3, ()),
    "to 42 deg, 20 mm, all alike": (RIG_ANGLES, 20e-3, ()),
    "the rig's: to 42 deg, 22 mm, weighted": (RIG_ANGLES, RIG_HALF_WIDTH, RIG_PARTS),
    "to 42 deg and the rim, all alike": (RIG_ANGLES, RIG_RIM, ()),
}
CONTACTS = ("P2", "P4", "P5", "P8", "spline")
STEP = 1e-3  # [s]


class Errors(NamedTuple):
    """At random places of the true surface, (n,) each."""

    along: NDArray[np.float64]  # distance of the patch along the true normal [m]
    turned: NDArray[np.float64]  # angle between the normals [deg]
    outside: NDArray[np.float64]  # how far beyond the patch's edge [m]


def errors(patch: Any, angles: tuple[float, float], across: tuple[float, float], n: int = 1500) -> Errors:
    """A patch against the true surface between angles about the axis [deg] and across the groove [mm]."""
    random = np.random.default_rng(0)
    u = np.radians(random.uniform(angles[0], angles[1], n)) * float(TRUE.trochlear_radius)
    v = 1e-3 * random.uniform(across[0], across[1], n)
    along, cosine, outside = (np.asarray(a) for a in _compared(patch, jnp.asarray(u), jnp.asarray(v)))
    return Errors(along, np.degrees(np.arccos(np.clip(cosine, -1, 1))), outside)


@jax.jit
def _compared(patch: Any, u: Any, v: Any) -> tuple[Any, Any, Any]:
    jet = TRUE.jet(u, v)
    point, normal = TRUE.chart.point(u, v, jet.f), TRUE.chart.normal(u, jet.f, jet.u, jet.v)
    q = patch.chart.coordinates(point)
    own = patch.jet(q.x, q.y)
    turned = patch.chart.axes.apply(patch.chart.normal(q.x, own.f, own.u, own.v))
    return (patch.chart.point(q.x, q.y, own.f) - point).dot(normal), turned.dot(normal), patch.outside(q.x, q.y)


def rms(a: NDArray[np.float64]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(a**2)))


def on_surface(scene: Any, surface: Any) -> Any:
    """A scene of the rig with another smooth surface under its button."""
    from pftwin.model.effects.sphere_contact import SphereContact

    contact = scene.effect("contact")
    return scene.with_effect(SphereContact(surface, contact.law, contact.center, contact.radius))


def smooth_implant() -> Any:
    """The true surface with arrays for leaves, as a scene takes it."""
    return jax.tree.map(lambda a: jnp.asarray(a) if isinstance(a, float) else a, TRUE)


def rows() -> Iterator[tuple[str, ...]]:
    """Region, contact, R^2, rms errors, frames beyond the patch, distance from the path on the true surface."""
    from pftwin import Status, rig, simulate
    from pftwin.geometry.patch.emphasis import emphasis
    from pftwin.geometry.patch.fit import fit_named
    from pftwin.geometry.patch.region import region_about
    from pftwin.rig.contacts import implant_mesh

    cases = (1, 2, 3, 4)
    true = {n: simulate(on_surface(rig.case(n), smooth_implant()), dt=0.5 * STEP).center for n in cases}
    mesh = implant_mesh()
    for contact in CONTACTS:
        for name, (angles, half_width, parts) in REGIONS.items():
            if contact == "spline" and parts:
                continue
            region = region_about(mesh, TRUE.chart, angles=angles, half_width=half_width)
            asked = {"tolerance": RIG_TOLERANCE} if contact == "spline" else {}
            fit = fit_named(mesh, contact, region=region, emphasis=emphasis(region, parts), **asked)
            found = [errors(fit.patch, *where) for where in (TRACKS, SLIDES, FLANK)]
            beyond, off = [], []
            for n in cases:
                result = simulate(on_surface(rig.case(n), fit.patch), dt=STEP)
                beyond.append(str(np.count_nonzero(result.flags & int(Status.LEFT_PATCH))))
                off.append(f"{1e3 * np.linalg.norm(result.center - true[n], axis=1).mean():.3f}")
            fits = f"{100 * fit.r_squared:.2f}", *(f"{1e3 * rms(e.along):.4f}" for e in found)
            title = f"the rig's: {name}" if contact == "spline" and half_width == RIG_RIM else name
            yield contact, title, *fits, ", ".join(beyond), ", ".join(off)


def main() -> None:
    """Prints the table."""
    from pftwin.base.runtime import configure

    configure()
    warnings.simplefilter("ignore")
    headings = (
        "contact",
        "region",
        "R^2, %",
        "where it tracks, mm",
        "where it slides",
        "to the rim",
        "frames beyond, cases 1 to 4",
        "off the true path, mm",
    )
    print("| " + " | ".join(headings) + " |\n|" + "---|" * len(headings))
    for row in rows():
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
