"""How smooth a contact's force is: a fine sweep along the groove, for each law and mesh, and its figure.

    python -m tests.benchmarks.smoothness docs/benchmarks

The button goes 6 mm along an arc about the trochlear axis, pressed about 0.2 mm into the lateral facet. On a smooth
surface the force would follow a smooth curve: what is left after a polynomial of degree 7 has been taken out is noise.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pftwin.base.spatial import Quaternion, Vec3
from pftwin.model.effects.base import Ground, Instant, Patella
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.motion import Frame
from pftwin.rig import geometry as rig

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh

WAY, POINTS = 6e-3, 1201  # [m]
DEPTH = 0.2e-3  # [m], about
DEGREE = 7
AT = 0.15  # [rad] where on the arc the sweep begins, proximal of the most anterior direction
SIDE = 7e-3  # of the button's middle, lateral of the groove's [m]
SIZES = {"3k": 0.056e-3, "28k": 0.006e-3, "100k": 0.00167e-3}


def swept(effect: Any, places: NDArray[np.float64], turn: Quaternion) -> NDArray[np.float64]:
    """The size of an effect's force on the patella at places (n, 3) of its origin, at rest [N]."""
    ready = effect.recentred(Vec3.zero())
    arrays, fixed = eqx.partition(ready, eqx.is_array)
    zero = jnp.zeros(())

    def force(a: Any, p: Any) -> Any:
        now = Instant(Patella.at_rest(Vec3(*p), turn), Ground(), Frame.world(), zero, zero)
        one = eqx.combine(a, fixed)
        return one.load(now, one.remember(now))[0].total().force.norm()

    return np.asarray(jax.jit(lambda a, p: jax.lax.map(lambda x: force(a, x), p))(arrays, jnp.asarray(places)))


def path() -> NDArray[np.float64]:
    """Places of the sphere's middle (n, 3) in the femur's frame [m]: an arc that presses as deep as is wanted."""
    from scipy.spatial import cKDTree

    from pftwin.geometry.patch.implant import rig_implant

    surface = cKDTree(rig_implant().mesh(deviation=SIZES["100k"]).vertices)
    angles = AT + np.linspace(0, WAY / 0.049, POINTS)

    def arc(radius: float) -> NDArray[np.float64]:
        return np.stack([radius * np.sin(angles), np.full(POINTS, SIDE), radius * np.cos(angles)], axis=1)

    low, high = 0.04, 0.06  # of the arc: deeper further in
    for _ in range(30):
        middle = 0.5 * (low + high)
        deep = rig.BUTTON_RADIUS - float(np.mean(surface.query(arc(middle)[::20])[0]))
        low, high = (middle, high) if deep > DEPTH else (low, middle)
    return arc(high)


def noise(force: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a smooth curve leaves of the force along the way [N]."""
    way = np.linspace(-1, 1, POINTS)
    return force - np.polynomial.Polynomial.fit(way, force, DEGREE)(way)


def effects() -> Iterator[tuple[str, str, Any]]:
    """Law, mesh and effect of what is swept; each is made when it is asked for."""
    from pftwin.geometry.contact.contact_mesh import contact_mesh
    from pftwin.geometry.contact.patch_mesh import lateral_of_groove, mesh_facets, patch_mesh
    from pftwin.geometry.mesh.icosphere import button_mesh
    from pftwin.geometry.patch.implant import rig_implant, rig_region
    from pftwin.model.effects.mesh_contact import MeshContact
    from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact
    from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact
    from pftwin.rig.contacts import gap_radius

    law, radius, zero = Hertz(jnp.asarray(rig.CONTACT_STIFFNESS)), jnp.asarray(rig.BUTTON_RADIUS), Vec3.zero()
    for size, deviation in SIZES.items():
        mesh = rig_implant().mesh(deviation=deviation)
        lateral = lateral_of_groove(mesh, rig_region(mesh))
        button = button_mesh(rig.BUTTON_RADIUS, deviation)
        sides = contact_mesh(mesh, lateral), contact_mesh(button)
        yield "contour, largest indentation", size, MeshContact(*sides, law, zero)
        yield "sphere, nearest point", size, MeshSphereContact(mesh_facets(mesh, lateral), law, zero, radius)
        yield "elastic layers", size, _layers(mesh, button)
        made = patch_mesh(mesh, rig.BUTTON_RADIUS, lateral)
        yield "sphere, overlap's volume", size, MeshVolumeContact(made, law, zero, radius, jnp.asarray(gap_radius()))


def _layers(mesh: SurfaceMesh, button: SurfaceMesh) -> Any:
    from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
    from pftwin.model.effects.elastic_foundation import ElasticFoundation
    from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer

    layer = checked_layer(500e6, 0.46, 5e-3)
    return ElasticFoundation(
        pressed_surface(mesh), pressing_surface(button), LinearFoundation(layer, layer), Vec3.zero()
    )


def main(folder: Path) -> None:
    """Sweeps, writes smoothness.json and the figure smoothness.png and .svg, prints a line for each contact."""
    import pftwin

    pftwin.configure()
    folder.mkdir(parents=True, exist_ok=True)
    places = path()
    turn = Quaternion.from_rotation_vector(Vec3(*(jnp.asarray(x) for x in (0.1, 0.2, 0.3))))
    found: dict[str, dict[str, Any]] = {}
    for law, size, effect in effects():
        force = swept(effect, places, turn)
        rest, mean = noise(force), float(np.mean(force))
        share, slope = np.ptp(rest) / mean, np.ptp(np.gradient(rest, WAY / (POINTS - 1)))
        one = {"mean_n": mean, "noise": share, "slope_n_per_m": slope, "force": force}
        found.setdefault(law, {})[size] = one
        print(f"{law}, {size}: {mean:.1f} N, noise {1e2 * share:.3g} %, of the slope {1e-3 * slope:.3g} N/mm")
    plain = jax.tree.map(lambda x: np.round(x, 6).tolist(), found)
    (folder / "smoothness.json").write_text(json.dumps(plain), encoding="utf-8")
    _draw(found, folder)


def _draw(found: dict[str, dict[str, Any]], folder: Path) -> None:
    from matplotlib.figure import Figure

    from pftwin.results.plots import COLOURS, house_style, save_figure
    from pftwin.results.plots.style import SMALL

    way = 1e3 * np.linspace(0, WAY, POINTS)
    with house_style():
        figure = Figure(figsize=(12.0, 6.0))
        panels = figure.subplots(2, len(found), sharex=True, sharey="row")
        for (above, below), (law, sizes) in zip(panels.T, found.items(), strict=True):
            for k, (size, one) in enumerate(sizes.items()):
                label = f"{size} triangles: {1e2 * one['noise']:.2g} %"
                above.plot(way, one["force"] / one["mean_n"], color=COLOURS[k], linewidth=1.0, label=label)
                below.plot(way, 1e2 * noise(one["force"]) / one["mean_n"], color=COLOURS[k], linewidth=1.0)
            above.set(title=law)
            above.legend(loc="upper left", fontsize=SMALL)
            below.set(xlabel="way along the groove [mm]", ylim=(-3, 3))
        panels[0, 0].set_ylabel("force over its mean")
        panels[1, 0].set_ylabel("less a smooth curve [%]")
        figure.suptitle("Force along a fine sweep, and its noise peak to peak")
    save_figure(figure, folder / "smoothness")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
