"""`pftwin fit-surface` on a femoral component that is turned obliquely in its frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from commands import pftwin, refused
from scipy.spatial.transform import Rotation

from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh, load_mesh, save_mesh
from pftwin.geometry.patch.region import directions_with_groove
from pftwin.results.plots.region import plot_directions

TURN = Rotation.random(rng=np.random.default_rng(1)).as_matrix()
NUMBERS = r"(-?[0-9.]+),(-?[0-9.]+),(-?[0-9.]+)"


def turned(mesh: SurfaceMesh, path: Path) -> Path:
    save_mesh(SurfaceMesh(mesh.vertices @ TURN.T, mesh.faces), path)
    return path


def test_a_groove_along_principal_directions_is_proposed_and_drawn(dm_knee: Path, tmp_path: Path) -> None:
    """The implant's own frame has -x anterior and +y proximal, to 25 deg; what is proposed first fits a patch."""
    own = load_mesh(dm_knee / "femoral_component_contact.stl", units="m")
    mesh, figure = turned(own, tmp_path / "femur.stl"), tmp_path / "axes.png"
    said = refused("fit-surface", mesh, "--units", "m", "-o", figure)
    first = re.search(rf"try: (--anterior={NUMBERS}) (--proximal={NUMBERS})", said)
    assert first is not None
    anterior, proximal = (np.array([float(v) for v in first.groups()[k : k + 3]]) for k in (1, 5))
    assert (TURN @ [-1, 0, 0]) @ anterior > np.cos(np.radians(25))
    assert (TURN @ [0, 1, 0]) @ proximal > np.cos(np.radians(10))
    assert f"along these directions a groove is found; {figure} shows them" in said
    assert figure.read_bytes().startswith(b"\x89PNG")
    done = pftwin("fit-surface", mesh, "--units", "m", first.group(1), first.group(5))
    assert done.exit_code == 0, done.output


def test_principal_directions_are_named_and_drawn_where_none_has_a_groove(tmp_path: Path) -> None:
    """An egg of three different widths, which are then its principal directions."""
    ball, figure = icosphere(0.04, 12), tmp_path / "axes.png"
    mesh = turned(SurfaceMesh(ball.vertices * [0.8, 1.0, 0.6], ball.faces), tmp_path / "femur.stl")
    said = refused("fit-surface", mesh, "--units", "m", "-o", figure)
    assert "check the anterior and proximal directions" in said
    found = re.search(rf"principal directions: {NUMBERS} or {NUMBERS} or {NUMBERS}; (.*) shows them", said)
    assert found is not None
    axes = np.array([float(v) for v in found.groups()[:9]]).reshape(3, 3)
    assert found.group(10) == str(figure)
    np.testing.assert_allclose(np.abs(axes @ TURN), np.eye(3)[[1, 0, 2]], atol=2e-2)
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "-o FIGURE.png shows them" in refused("fit-surface", mesh, "--units", "m")


def test_a_single_candidate_fills_the_figure_with_its_title_inside(dm_knee: Path) -> None:
    """It stood beside an empty half, and its title was cut off."""
    from matplotlib.text import Text

    mesh = load_mesh(dm_knee / "femoral_component_contact.stl", units="m")
    figure = plot_directions(directions_with_groove(mesh)[:1], [], mesh)
    figure.draw_without_rendering()
    (title,) = (t.get_window_extent() for t in figure.findobj(Text) if t.get_text().startswith("anterior "))
    assert title.y1 <= figure.bbox.y1
    assert title.x1 <= figure.bbox.x1
    assert figure.axes[0].get_window_extent().width > 0.6 * figure.bbox.width
