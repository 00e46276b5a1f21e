"""The DM recording: is the contact force at the recorded poses what tendons, ligaments and weight demand?"""

from __future__ import annotations

from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recorded_pulls import Recording
from wrapped_line import Ellipsoid

from pftwin.files.mocap import read_csv, read_poses
from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
from pftwin.geometry.contact.depths import depths
from pftwin.geometry.mesh.mesh import SurfaceMesh, load_mesh
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.studies.contact_map import mapping
from pftwin.studies.contact_map.mapping import ContactMap, map_contact

pytestmark = pytest.mark.slow


def areas_of(mesh: SurfaceMesh) -> np.ndarray:
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area_faces


@contextmanager
def sums_over_own_areas(areas):
    """As the program sums that made the recording: over triangles' areas as they are.

    Ours takes them across the femur's normal, as pressure acts, which on this dome is up to 2 % less.
    """

    def depths_with_own_areas(*where, **options):
        d = depths(*where, **options)
        return d._replace(area=areas[d.triangle], tilting=0.0 * d.tilting)

    jax.clear_caches()  # programs of the meshes that others have compiled
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mapping, "depths", depths_with_own_areas)
        yield
    jax.clear_caches()


@pytest.fixture(scope="module")
def recording(dm_knee) -> tuple[ContactMap, Recording, np.ndarray]:
    poses = read_poses(dm_knee / "passive_flexion_poses.csv")
    femur, button = (
        load_mesh(dm_knee / f"{n}.stl", units="m") for n in ("femoral_component_contact", "patellar_button_contact")
    )
    layer = checked_layer(46.3e6, 0.46, 5e-3)
    with sums_over_own_areas(jnp.asarray(areas_of(button))):
        found = map_contact(
            pressed_surface(femur),
            pressing_surface(button),
            LinearFoundation(layer, layer),
            poses["patella"].relative_to(poses["femur"]),
            triangles=len(button.faces),
        )
    flexion = np.degrees(read_csv(dm_knee / "passive_flexion_poses.csv", units="1").column("knee_flexion"))
    return found, Recording(dm_knee, poses), flexion


def compared(force: np.ndarray, demand: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much larger the contact force is than what is demanded [%], and the angle between the two [deg]."""
    size, wanted = np.linalg.norm(force, axis=1), np.linalg.norm(demand, axis=1)
    cosine = np.einsum("ij,ij->i", force, demand) / (size * wanted)
    return 100 * (size / wanted - 1), np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_a_taut_line_around_a_sphere_has_its_closed_form():
    ball = Ellipsoid(np.array([1.0, 2.0, 3.0]), np.eye(3), np.full(3, 0.5))
    start, end = (ball.center + np.array([x, 0.0, 0.1]) for x in (-1.0, 1.0))
    far = np.linalg.norm(start - ball.center)
    touching = np.arccos(0.5 / far)
    between = np.arccos((start - ball.center) @ (end - ball.center) / far**2)
    length, way = ball.wrapped(start, end)
    assert length == pytest.approx(2 * np.sqrt(far**2 - 0.25) + 0.5 * (between - 2 * touching), rel=1e-4)
    to_middle = (ball.center - start) / far
    assert np.arccos(way @ to_middle) == pytest.approx(np.arcsin(0.5 / far), abs=0.01)
    assert ball.wrapped(start, start + np.array([0.0, 1.0, 0.0]))[0] == pytest.approx(1.0)  # clear of it


def test_around_its_ellipsoid_the_lpfl_has_its_recorded_tension(recording):
    # So the wrap is where the recording's was. Along straight lines it would bear less than half at 70 deg.
    _, pulls, flexion = recording
    frames = np.flatnonzero((pulls.times >= 0.5) & (flexion >= 2) & (flexion <= 72))[::10]
    _, tension = pulls.wrapped_lpfl(frames)
    recorded = pulls.tensions.column("lpfl")[frames]
    assert recorded.max() > 50
    np.testing.assert_allclose(tension, recorded, rtol=0.04, atol=0.02)
    straight = sum(s.tension(np.linalg.norm(s.other_end - s.on_patella, axis=1))[frames] for s in pulls.strands["LPFL"])
    assert straight[-1] < 0.5 * recorded[-1]


def test_the_contact_force_is_what_the_recording_demands(recording):
    found, pulls, flexion = recording
    frames = np.flatnonzero((found.times >= 0.5) & (flexion >= 2) & (flexion <= 72))
    force, tension = pulls.wrapped_lpfl(frames)
    lpfl = (pulls.tensions.column("lpfl")[frames] / np.maximum(tension, 1e-6))[:, None] * force
    rest = pulls.muscles_and_weight() + sum(pulls.straight(k) + pulls.viscous(k) for k in ("PT", "MPFL"))
    excess, angle = compared(found.force[frames], -(rest[frames] + lpfl))
    assert np.sqrt(np.mean(excess**2)) < 2
    assert np.abs(excess).max() < 5.5
    # 5 % and 2 deg from 2 to 72 deg were hoped for; 63 deg is as far as 2 deg goes (docs/bring_your_own_knee.md).
    # Twice the recorded patella moves with a jerk.
    early = flexion[frames] <= 63
    assert ((np.abs(excess) > 5) | (angle > 2))[early].sum() <= 2
    assert angle[~early].max() < 3.2


def test_along_straight_lines_it_is_so_in_the_middle_only(recording):
    found, pulls, flexion = recording
    demand = -(pulls.muscles_and_weight() + sum(pulls.straight(k) for k in ("PT", "MPFL", "LPFL")))
    middle = (found.times >= 0.5) & (flexion >= 13) & (flexion <= 42)
    excess, angle = compared(found.force[middle], demand[middle])
    assert np.abs(excess).max() < 5
    assert angle.max() < 2
