"""A button where no button can be: deep in the bone, wholly inside it, or nowhere near. Every method says so."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
import pytest
from scenes import (
    J,
    about,
    contact,
    groove_patch,
    knee_motion,
    look,
    run,
    starting_as_it_is,
    state_at,
    still_guide,
    vec,
)

from pftwin.base.spatial import Pose, Quaternion, Vec3
from pftwin.dynamics.state import System
from pftwin.dynamics.status import Status, reservations, status_of_frame
from pftwin.geometry.mesh.icosphere import icosphere
from pftwin.model.effects.base import Effect
from pftwin.model.effects.contact_law import Hertz
from pftwin.model.effects.foundation_law import LinearFoundation, checked_layer
from pftwin.model.scene import PatellaBody, Scene

BONE, BUTTON = 0.04, 0.012  # radii [m]
LAW = Hertz(J(1e3))  # so soft that in one short frame nothing moves


def contours() -> Effect:
    from pftwin.geometry.contact.contact_mesh import contact_mesh
    from pftwin.model.effects.mesh_contact import MeshContact

    return MeshContact(contact_mesh(icosphere(BONE, 10)), contact_mesh(icosphere(BUTTON, 6)), LAW, vec(0, 0, 0))


def volume() -> Effect:
    from pftwin.geometry.contact.patch_mesh import patch_mesh
    from pftwin.model.effects.mesh_volume_contact import MeshVolumeContact

    mesh = patch_mesh(icosphere(BONE, 10), BUTTON)
    return MeshVolumeContact(mesh, LAW, vec(0, 0, 0), J(BUTTON), J(0.01))


def nearest() -> Effect:
    from pftwin.geometry.contact.patch_mesh import mesh_facets
    from pftwin.model.effects.mesh_sphere_contact import MeshSphereContact

    return MeshSphereContact(mesh_facets(icosphere(BONE, 10)), LAW, vec(0, 0, 0), J(BUTTON))


def foundation() -> Effect:
    from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
    from pftwin.model.effects.elastic_foundation import ElasticFoundation

    layer = checked_layer(1e3, 0.4, 3e-3)
    surfaces = pressed_surface(icosphere(BONE, 10)), pressing_surface(icosphere(BUTTON, 6))
    return ElasticFoundation(*surfaces, LinearFoundation(layer, layer), vec(0, 0, 0))


@pytest.fixture(scope="module", params=[contours, volume, nearest, foundation], ids=lambda make: make.__name__)
def scene(request) -> Scene:
    body = PatellaBody(J(0.12), vec(3e-5, 3e-5, 4e-5), vec(0, 0, 0))
    return Scene(body, (request.param(),), knee_motion(4), Pose(vec(0, 0, 0), Quaternion.identity()))


def middle(height: float) -> tuple[float, float, float]:
    """A place of the button's middle so far from the bone's."""
    return 0.1 * height, -0.2 * height, height * 0.95**0.5


@eqx.filter_jit
def status_at(scene: Scene, position: Vec3) -> jax.Array:
    """Of a frame with the button there, without the step that leads to the next: that compiles three times longer."""
    sys = System.of(scene)
    state = eqx.tree_at(lambda s: s.position, state_at(sys, (0, 0, 1.0)), position)
    now = still_guide().instant(state.patella(), 0.0)
    reports = {e.name: e.report(now, e.remember(now))[0] for e in sys.effects}
    return status_of_frame(scene, reports, state, J(0.01), None)


def first_status(scene: Scene, height: float) -> Status:
    return Status(int(status_at(scene, vec(*middle(height)))))


@pytest.mark.parametrize("height", [0.0, 0.006, 0.02], ids=["at the middle", "off the middle", "under the surface"])
@pytest.mark.slow
def test_wholly_inside_it_is_too_deep(scene, height):
    assert Status.DEEP_INDENTATION in first_status(scene, height)


@pytest.mark.slow
def test_half_inside_it_is_too_deep(scene):
    """In a motion, which says of its first frame what is said of it alone."""
    there = eqx.tree_at(lambda s: s.start.position, scene, vec(*middle(BONE)))
    _, seen = run(there, starting_as_it_is(there), J(1))
    said = Status(int(np.asarray(seen.status)[0]))
    assert Status.DEEP_INDENTATION in said
    assert said == first_status(scene, BONE)


def test_5_mm_deep_is_too_deep(scene):
    assert Status.DEEP_INDENTATION in first_status(scene, BONE + BUTTON - 5.5e-3)


def test_a_tenth_of_a_millimetre_is_not(scene):
    assert first_status(scene, BONE + BUTTON - 3e-4) in (Status.OK, Status.NO_CONTACT)  # it is made of triangles


@pytest.mark.parametrize("height", [0.054, 0.1, 1.0])
def test_nothing_touches_above_the_bone(scene, height):
    assert first_status(scene, height) == Status.NO_CONTACT


@pytest.mark.parametrize(("depth", "said"), [(0.028, Status.SEARCH_OVERFLOW), (1e-4, Status.OK), (-0.003, Status.OK)])
def test_a_small_button_far_inside_a_fitted_surface_may_touch(depth, said):
    """The nearest point of a wall is 15 mm from where the search of a button of 1 mm begins and takes short steps."""
    small = eqx.tree_at(lambda e: e.radius, contact(LAW, groove_patch()), J(1e-3))
    lateral, slope = 0.012, np.radians(25)
    wall = np.hypot(lateral, 0.005) * np.tan(slope) + 1e-3 / np.cos(slope)  # nearly a plane
    report = eqx.filter_jit(lambda now: small.report(now, small.remember(now))[0])
    assert Status(int(reservations(report(look((0, lateral, wall - depth)))))) & Status.SEARCH_OVERFLOW == said


@pytest.mark.slow
def test_pairs_that_there_is_no_room_for_are_said():
    """Of contours; a foundation's load is not known then, see `test_elastic_foundation_motion`."""
    from pftwin.geometry.bvh.pairs import PairListLengths
    from pftwin.geometry.contact.contour import mesh_pair

    made = contours()
    tight = eqx.filter_jit(mesh_pair)(made.femur, made.patella, room=PairListLengths(2048, 8192, 32))  # type: ignore[attr-defined]
    short = eqx.tree_at(lambda e: e.meshes, made, tight, is_leaf=lambda x: x is None)
    report = eqx.filter_jit(lambda e, now: e.report(now, None)[0])
    deep, apart = (report(short, look((0, 0, BONE + BUTTON - d))) for d in (4e-3, -3e-3))
    said = [Status(int(reservations(r))) for r in (deep, apart)]
    assert Status.SEARCH_OVERFLOW in said[0]
    assert said[1] == Status.OK


def test_the_search_for_contours_alone_sees_nothing_of_it():
    ready = about(contours(), vec(0, 0, 0))
    search = jax.jit(lambda pose: ready.meshes.contacts(pose))  # type: ignore[attr-defined]
    wholly, half = (search(Pose(vec(0, 0, z), Quaternion.identity())) for z in (0.001, BONE))
    assert int(wholly.pairs) == 0
    assert int(half.pairs) > 0
    assert float(half.each[0].indentation) == 0  # from its corners inward it is farther than the search looks
    assert not bool(wholly.too_deep)
    assert not bool(half.too_deep)


def test_a_bone_wholly_inside_the_button_is_too_deep_and_says_how_far():
    """A part of the femur's surface that a large button has gone over: no triangles meet."""
    from pftwin.geometry.contact.contact_mesh import contact_mesh
    from pftwin.model.effects.mesh_contact import MeshContact
    from pftwin.studies.hard_cases.ground import TiltedGround, mesh_on

    plate = contact_mesh(mesh_on(TiltedGround(lambda u, v: 0.0 * u, (0.01, 0.01))))
    made = about(MeshContact(plate, contact_mesh(icosphere(0.05, 2)), LAW, vec(0, 0, 0)), vec(0, 0, 0))
    report = eqx.filter_jit(lambda now: made.report(now, None)[0])
    inside, apart = (report(look((0, 0, z))) for z in (0.02, 0.06))
    assert [Status(int(reservations(r))) for r in (inside, apart)] == [Status.DEEP_INDENTATION, Status.OK]
    assert 0.01 < float(inside["indentation_medial"]) < 0.05
    assert np.isnan(float(apart["indentation_medial"]))


@pytest.mark.slow
def test_behind_an_open_surface_is_too_deep_and_says_how_far():
    """A femur's surface without its back: a button that hangs far below it does not just touch nothing."""
    from pftwin.geometry.contact.contact_mesh import contact_mesh
    from pftwin.model.effects.mesh_contact import MeshContact
    from pftwin.studies.hard_cases.ground import TiltedGround, lateral_of, mesh_on

    plate = mesh_on(TiltedGround(lambda u, v: 0.0 * u, (0.025, 0.02)))
    femur, button = contact_mesh(plate, lateral_of(plate)), contact_mesh(icosphere(BUTTON, 6))
    made = about(MeshContact(femur, button, LAW, vec(0, 0, 0)), vec(0, 0, 0))
    report = eqx.filter_jit(lambda now: made.report(now, None)[0])
    below, beside, above = (report(look(place)) for place in ((0, 0.013, -0.07), (0.05, 0, -0.07), (0, 0, 0.07)))
    assert [Status(int(reservations(r))) for r in (below, beside, above)] == [Status.DEEP_INDENTATION] + [Status.OK] * 2
    assert float(below["indentation_lateral"]) == pytest.approx(0.07, abs=BUTTON)
    assert np.isnan(float(below["indentation_medial"]))
    assert np.isnan(float(beside["indentation_lateral"]))
