"""Lines of the live page run over their obstacles, also where they begin or cease to touch them."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
from wrapped_scene import wrapped_result

from fitting.cli.live.drawing import DrawnKnee
from fitting.cli.live.engine import Still
from fitting.cli.live.motion import DrawnMotion
from pftwin.results.viewer.recorded import Recorded


class Canvas:
    """Keeps the meshes that were added, by name."""

    def __init__(self) -> None:
        self.meshes = {}

    def add_frame(self, name, **options):
        return SimpleNamespace(visible=True)

    def add_mesh_simple(self, name, vertices, triangles, **options):
        self.meshes[name] = SimpleNamespace(vertices=vertices, triangles=triangles)
        return self.meshes[name]


def test_the_treated_motions_arcs_are_drawn():
    """`Still` has meshes of the untreated scene, and lines of each result."""
    result = wrapped_result()
    shown = DrawnMotion(Recorded.of(result, geometry=Still(result.scene).geometry(result)), 10.0)
    for name in ("quadriceps", "patellar_tendon", "brace"):
        vertices, _ = shown.lines[name]
        middles = vertices.reshape(result.times.size, 10, -1, 3).mean(axis=2)
        length = np.linalg.norm(np.diff(middles, axis=1), axis=2).sum(axis=1)
        np.testing.assert_allclose(length, 1e3 * result.effects[name]["length"], atol=1e-3)


def test_a_line_that_begins_to_bend_gets_a_mesh_of_its_own():
    bent = Recorded.of(wrapped_result())
    straight = dataclasses.replace(bent, geometry=bent.geometry.drop_vars("patellar_tendon_arc"))
    canvas = Canvas()
    knee = DrawnKnee(canvas, "/after", "#D55E00")
    for recorded, rings in ((straight, 2), (bent, 10), (bent, 10), (straight, 2)):
        shown = DrawnMotion(recorded, 10.0)
        knee.set(shown)
        knee.frame(3)
        mesh = canvas.meshes["/after/patellar_tendon"]
        np.testing.assert_array_equal(mesh.vertices, shown.lines["patellar_tendon"][0][3])
        assert len(mesh.vertices) == rings * 10
        assert mesh.triangles.max() == rings * 10 - 1
