"""A sphere on a mesh: the same as on the smooth surface that the mesh is of, on both facets, with derivatives."""

from __future__ import annotations

import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from height_meshes import grid, lateral, level
from scenes import RADIUS, J, gravity, knee, look, march, run, settled, state_at, system, trochlea, vec

from pftwin.base.errors import InputError
from pftwin.base.spatial import Vec3
from pftwin.dynamics.frame_states import first_guide
from pftwin.dynamics.observe import observe
from pftwin.dynamics.state import System
from pftwin.dynamics.status import Status
from pftwin.geometry.bvh import wide
from pftwin.geometry.contact.patch_mesh import MeshFacets, lateral_of_groove, mesh_facets
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.geometry.mesh.mesh import SurfaceMesh
from pftwin.geometry.patch.implant import rig_implant, rig_region
from pftwin.model.effects.base import Load, Patella
from pftwin.model.effects.contact_law import Flores, Hertz
from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact
from pftwin.model.effects.sphere_contact import SphereContact
from pftwin.model.scene import Scene
from pftwin.rig.contacts import implant_mesh

LAW = Hertz(J(2e8))
BUTTON = J(0.025)


PLATE = mesh_facets(grid(level))
SLOPE = np.radians(20)
VEE_MESH = grid(lambda u, v: np.abs(v) * np.tan(SLOPE))
VEE = mesh_facets(VEE_MESH, lateral(VEE_MESH))


def on(facets: MeshFacets, law=LAW, radius=None) -> MeshSphereContact:
    return MeshSphereContact(facets, law, vec(0, 0, 0), J(RADIUS) if radius is None else radius)


@eqx.filter_jit
def loaded(effect, now):
    load, _ = effect.load(now, effect.remember(now))
    return load, load.total(), effect.observe(now, effect.remember(now))


def test_a_plate_pushes_by_the_law_alone():
    depth = 1e-4
    load, total, shown = loaded(on(PLATE), look((0.0012, 0.0031, RADIUS - depth)))
    force = 2e8 * depth**1.5
    assert isinstance(load, Load)
    np.testing.assert_allclose(total.force.array(), [0, 0, force], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(total.moment.array(), 0, atol=1e-12)
    (term,) = load.stiff
    assert term.unilateral
    np.testing.assert_allclose(term.stiffness, 1.5 * force / depth, rtol=1e-9)
    np.testing.assert_allclose(shown["point_medial"], [0.0012, 0.0031, 0], atol=1e-12)
    np.testing.assert_allclose(shown["indentation_medial"], depth, rtol=1e-9)
    assert float(shown["overflow"]) == 0
    assert float(shown["off_patch"]) == 0
    assert set(shown) == set(MeshSphereContact.observables)


def test_both_sides_of_a_vee_are_separate_contacts():
    depth, aside = 1e-4, 2e-5
    z = (RADIUS - depth) / np.cos(SLOPE)
    _, total, shown = loaded(on(VEE), look((0.001, aside, z)))
    for facet, side in (("medial", -1), ("lateral", 1)):
        expected = depth + side * aside * np.sin(SLOPE)
        np.testing.assert_allclose(shown[f"indentation_{facet}"], expected, rtol=1e-6)
        np.testing.assert_allclose(shown[f"force_{facet}"], 2e8 * expected**1.5, rtol=1e-6)
        assert np.sign(shown[f"point_{facet}"][1]) == side
    np.testing.assert_allclose(shown["force"], shown["force_medial"] + shown["force_lateral"])
    np.testing.assert_allclose(total.force.array(), [shown["force_x"], shown["force_y"], shown["force_z"]], atol=1e-9)


def test_leaning_on_one_side_the_seam_is_no_second_contact():
    """A sphere deep in one flank: the other facet's nearest point is on the seam, on the way to the first."""
    y = 0.012
    z = y * np.tan(SLOPE) + (RADIUS - 1e-4) / np.cos(SLOPE)
    _, _, shown = loaded(on(VEE), look((0.001, y, z)))
    assert float(shown["force_medial"]) == 0
    assert np.isnan(shown["indentation_medial"])
    np.testing.assert_allclose(shown["indentation_lateral"], 1e-4, rtol=1e-6)


@pytest.mark.slow
def test_one_contact_on_a_plain_surface_is_not_counted_twice_by_its_labels():
    flat = grid(lambda u, v: 0 * u)
    both = mesh_facets(flat, lateral(flat))
    for y in (-0.004, -1e-9, 0.0, 1e-9, 0.0013):
        now = look((0.001, y, RADIUS - 1e-4))
        assert float(loaded(on(both), now)[2]["force"]) == pytest.approx(float(loaded(on(PLATE), now)[2]["force"]))


@pytest.fixture(scope="module")
def femur() -> MeshFacets:
    mesh = implant_mesh()
    return mesh_facets(mesh, lateral_of_groove(mesh, rig_region(mesh)))


@pytest.mark.slow
def test_the_meshed_implant_is_the_smooth_one(femur):
    """Both facets' depths within the mesh's 0.006 mm, at places along the groove."""
    smooth = SphereContact(rig_implant(), LAW, vec(0, 0, 0), BUTTON)
    effect = on(femur, radius=BUTTON)

    @eqx.filter_jit
    def shown(e, now):
        return e.observe(now, e.remember(now))

    touched = 0
    for degrees in range(-60, 30, 10):
        a = np.radians(degrees)
        now = look((0.0489 * np.sin(a), 0.1 * a * 0.0248, 0.0489 * np.cos(a)))
        mesh, ideal = shown(effect, now), shown(smooth, now)
        assert float(mesh["overflow"]) == 0
        for facet in ("medial", "lateral"):
            if float(mesh[f"force_{facet}"]) > 0 and float(ideal[f"force_{facet}"]) > 0:
                touched += 1
                assert abs(mesh[f"indentation_{facet}"] - ideal[f"indentation_{facet}"]) < 8e-6
                np.testing.assert_allclose(mesh[f"point_{facet}"], ideal[f"point_{facet}"], atol=1.5e-3)
    assert touched >= 8


@pytest.fixture(scope="module")
def bumps() -> SurfaceMesh:
    return grid(lambda u, v: 1e-3 * np.cos(300 * u) * np.cos(300 * v))


@pytest.fixture(scope="module")
def slopes_of(bumps):
    """Energy and force, and their slopes by place, radius and a shift of the mesh, in both modes."""
    contact_on = mesh_facets(bumps)

    def energy(p, radius, shift):
        moved = eqx.tree_at(lambda f: f.triangles, contact_on, contact_on.triangles + shift)
        effect = MeshSphereContact(moved, LAW, vec(0, 0, 0), radius)
        now = eqx.tree_at(lambda n: n.patella.position, look(), Vec3.from_array(p))
        load, _ = effect.load(now, effect.remember(now))
        found = load.energy, load.total().force.array()
        return found, found

    return [jax.jit(mode(energy, argnums=(0, 1, 2), has_aux=True)) for mode in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize("spot", ["face", "edge", "vertex", "clear", "inside", "rim"])
def test_derivatives_are_finite_and_the_force_is_the_energys(spot, bumps, slopes_of):
    step = 0.06 / 40
    top = float(bumps.vertices[:, 2].max())
    places = {
        "face": (0.0004, 0.0002, top + RADIUS - 2e-4),
        "edge": (0.5 * step, 0.0, top + RADIUS - 2e-4),
        "vertex": (0.0, 0.0, top + RADIUS - 2e-4),
        "clear": (0.0004, 0.0002, top + RADIUS + 1e-3),
        "inside": (0.0004, 0.0002, -0.003),
        "rim": (0.031, 0.0002, 0.0),
    }
    for slopes_and_values in slopes_of:
        slopes, (stored, pushed) = slopes_and_values(J(places[spot]), J(RADIUS), J(0.0))
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
        np.testing.assert_allclose(slopes[0][0], -pushed, rtol=1e-9, atol=1e-9)  # the force is the energy's slope
        assert (float(stored) > 0) == (spot != "clear")


def test_a_button_inside_is_pushed_out_and_one_beyond_the_rim_is_not_sucked_in():
    _, total, shown = loaded(on(PLATE), look((0.0, 0.0, -0.001)))
    np.testing.assert_allclose(shown["indentation_medial"], RADIUS + 0.001, rtol=1e-9)
    assert float(total.force.z) > 0
    _, _, shown = loaded(on(PLATE), look((0.03 + RADIUS + 0.001, 0.0, -0.002)))
    assert float(shown["force"]) == 0
    _, total, shown = loaded(on(PLATE), look((0.032, 0.0, np.sqrt((RADIUS - 1e-4) ** 2 - 0.002**2))))
    np.testing.assert_allclose(shown["indentation_medial"], 1e-4, rtol=1e-6)
    np.testing.assert_allclose(shown["off_patch"], 0.002, rtol=1e-6)
    assert float(total.force.x) > 0


def test_a_sphere_comes_to_rest_on_a_sphere_of_triangles():
    """Dropped on the top of a ball it is held by the Flores law at the depth that bears its weight."""
    ball = icosphere(0.03, 16)
    top = float(ball.vertices[:, 2].max())
    assert top == pytest.approx(0.03)
    turned = mesh_facets(ball)
    sys = system(gravity(), on(turned, Flores(J(2e8), J(0.5))))
    weight = 0.12 * 9.81
    depth = (weight / 2e8) ** (2 / 3)
    z = float(_height(turned))
    state = march(sys, state_at(sys, (0, 0, z + RADIUS + 1e-5)), 0.2, 400)
    assert float(state.position.z) == pytest.approx(z + RADIUS - depth, abs=1e-6)
    assert abs(float(state.velocity.z)) < 1e-4


def _height(facets: MeshFacets) -> jax.Array:
    far = Vec3(J(0.0), J(0.0), J(0.06))
    return 0.06 - facets.points(far)[0].distance


def test_labels_must_fit_and_a_groove_line_divides_the_implant(femur):
    mesh = implant_mesh()
    with pytest.raises(InputError, match="labels of shape"):
        mesh_facets(mesh, [True])
    with pytest.raises(InputError, match="no triangle is lateral"):
        mesh_facets(mesh, np.zeros(len(mesh.faces), bool))
    assert femur.count == 2
    sides = np.asarray(femur.triangles).reshape(2, -1, 3, 3).mean(axis=(1, 2))[:, 1]
    assert sides[0] < -0.005 < 0.005 < sides[1]


def small_knee() -> Scene:
    """The small knee of other tests with a mesh of its trochlea in the place of the patch, as far as that goes."""
    scene = knee(6)
    patch = trochlea()
    half = tuple(float(h) for h in patch.half_size)
    flat = grid(lambda u, v: np.asarray(patch.height(J(u), J(v))), 181, half)
    place = patch.chart.from_frame(Vec3.from_array(J(flat.vertices)))
    mesh = SurfaceMesh(np.asarray(place.array()), flat.faces)
    return scene.with_effect(MeshSphereContact(mesh_facets(mesh, lateral(flat)), LAW, vec(0, 0, 0), J(RADIUS)))


@pytest.mark.slow
def test_a_knee_moves_on_a_mesh_as_on_its_patch_and_a_search_without_room_is_in_its_status(monkeypatch, request):
    """From the patch's equilibrium, for static balance on flat triangles is not what Newton's method finds."""
    patch, scene = knee(6, LAW), small_knee()
    start = settled(patch)
    still = first_guide(scene).instant(Patella.at_rest(start.pose.position, start.pose.orientation), 0.0)
    on_mesh = eqx.tree_at(lambda s: s.memories, start, System.of(scene).remember(still), is_leaf=lambda x: x is None)
    smooth, _ = run(patch, start)
    path, shown = run(scene, on_mesh)
    assert (np.asarray(shown.status) == 0).all()
    way = np.linalg.norm((path.states.position - smooth.states.position).array(), axis=1)
    assert 0 < way.max() < 0.1e-3
    assert float(np.ptp(np.asarray(smooth.states.position.array()), axis=0).max()) > 0.2e-3
    request.addfinalizer(jax.clear_caches)
    monkeypatch.setattr(wide, "WIDTH", 1)
    jax.clear_caches()  # what was traced before knows the old width
    short = eqx.filter_jit(lambda s, p: observe(s, p))(scene, path)
    assert (np.asarray(short.status) & int(Status.SEARCH_OVERFLOW)).all()
    assert "ran out of room" in Status(int(short.status[0])).describe()


@pytest.mark.slow
def test_scenes_without_a_mesh_do_not_import_its_search():
    code = "import sys, pftwin; pftwin.rig.case(1); print([m for m in sys.modules if 'bvh' in m or 'mesh_sphere' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
