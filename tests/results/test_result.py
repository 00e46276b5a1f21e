"""Results: content against its sources, units everywhere, files whole or not at all, equilibrium reports."""

from __future__ import annotations

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scene import GROOVE_AT, knee_flexion, small_result, small_scene, vec

import pftwin
from pftwin.base.errors import InputError, OutputError
from pftwin.base.output import written_whole
from pftwin.base.rotations import tibiofemoral_angles
from pftwin.base.spatial import Quaternion
from pftwin.dynamics.equilibrium import Solution
from pftwin.dynamics.equilibrium_report import EquilibriumReport
from pftwin.dynamics.state import Guide
from pftwin.dynamics.status import Status
from pftwin.files.mocap.csv_files import read_csv
from pftwin.files.mocap.poses import PoseSeries
from pftwin.files.mocap.sto import read_sto
from pftwin.files.result_files import load_dataset
from pftwin.model.motion import KneeMotion
from pftwin.model.motion_on_host import tibia_orientation


@pytest.fixture(scope="module")
def result():
    return small_result()


@pytest.fixture(scope="module")
def data(result):
    return result.to_dataset()


UNITS = {  # written by hand, from docs/conventions.md: SI, and degrees for angles
    "m": "sphere_center patella_position tibia_position patella_shift groove_position groove_offset "
    "contact_indentation_lateral contact_indentation_medial contact_off_patch contact_point_lateral "
    "contact_point_medial patellar_tendon_length quadriceps_length estimated_error_path",
    "deg": "patella_flexion patella_tilt patella_rotation knee_flexion knee_adduction knee_internal_rotation",
    "N": "contact_force contact_force_lateral contact_force_medial contact_force_x contact_force_y contact_force_z "
    "gravity_weight patellar_tendon_tension quadriceps_tension estimated_error_contact_force "
    "estimated_error_medial_facet estimated_error_lateral_facet",
    "J": "kinetic_energy stored_energy_contact stored_energy_gravity stored_energy_patellar_tendon "
    "stored_energy_quadriceps total_energy work heat numerical_dissipation energy_budget_error",
    "s": "time",
    "1": "contact_overflow patella_quaternion tibia_quaternion dislocated status axis component",
}


def test_units_are_those_of_a_table_written_by_hand(result, tmp_path):
    result.save(tmp_path / "run.nc")
    for data in (result.to_dataset(), load_dataset(tmp_path / "run.nc")):
        found = {str(name): data[name].attrs["units"] for name in data.variables}
        assert found == {name: unit for unit, names in UNITS.items() for name in names.split()}


def test_values_are_in_their_units(data, result):
    """Against what is known of this knee: it bends from 45 to 55 degrees and weighs 0.12 kg."""
    assert data["knee_flexion"].values.max() == pytest.approx(55, abs=0.1)
    assert data["time"].values[-1] == pytest.approx(0.4)
    np.testing.assert_allclose(data["gravity_weight"], 0.12 * 9.81, rtol=1e-6)
    stretch = data["quadriceps_length"].values[0] - 0.1432  # held still at first: N and m agree by N/m
    assert data["quadriceps_tension"].values[0] == pytest.approx(156.0 * stretch, rel=0.2)
    np.testing.assert_allclose(np.radians(data["patella_tilt"]), result.angles.tilt)


def test_attributes_tell_of_the_start(data, result):
    """Facets that bear load are those with a force; places in millimetres and degrees as their names say."""
    loaded = [side for side in ("medial", "lateral") if data[f"contact_force_{side}"].values[0] > 0]
    assert sorted(data.attrs["equilibrium_facets"].split()) == sorted(loaded) != []
    start = result.equilibrium
    assert data.attrs["equilibrium_moved_mm"] == pytest.approx(1000 * start.moved)
    assert data.attrs["equilibrium_turned_deg"] == pytest.approx(start.turned * 180 / np.pi)
    assert data.attrs["equilibrium_residual_N"] == start.residual
    assert data.attrs["equilibrium_smallest_stiffness_N_per_m"] == start.eigenvalues.min() > 0
    assert (data.attrs["equilibrium_converged"], data.attrs["equilibrium_kind"]) == (1, start.kind)


def test_every_variable_and_coordinate_has_unit_and_long_name(data):
    for name in [*data.data_vars, *data.coords]:
        assert data[name].attrs.get("units"), name
        assert len(data[name].attrs.get("long_name", "")) > 3, name
        if np.issubdtype(data[name].dtype, np.floating):
            assert data[name].dtype == np.float64, name


def test_holds_what_the_issue_lists(data):
    assert set(data.data_vars) >= {
        "sphere_center",
        "patella_position",
        "patella_quaternion",
        "patella_flexion",
        "patella_tilt",
        "patella_rotation",
        "patella_shift",
        "knee_flexion",
        "contact_force",
        "contact_force_medial",
        "contact_point_lateral",
        "contact_indentation_medial",
        "patellar_tendon_tension",
        "patellar_tendon_length",
        "quadriceps_tension",
        "kinetic_energy",
        "stored_energy_contact",
        "total_energy",
        "work",
        "heat",
        "numerical_dissipation",
        "energy_budget_error",
        "status",
        "groove_offset",
        "dislocated",
    }
    assert data["contact_point_lateral"].dims == ("time", "axis")
    assert list(data["axis"].values) == ["x", "y", "z"]
    for key in ("pftwin_version", "jax_version", "dtype", "integrator", "dt_s", "equilibrium_residual_N"):
        assert key in data.attrs
    assert data.attrs["equilibrium_smallest_stiffness_N_per_m"] > 0


def test_angles_and_frames_agree_with_scipy_and_the_prescribed_motion(result, data):
    from scipy.spatial.transform import Rotation

    y, z, x = Rotation.from_quat(result.quaternion, scalar_first=True).as_euler("YZX", degrees=True).T
    np.testing.assert_allclose(data["patella_flexion"], -y, atol=1e-9)
    np.testing.assert_allclose(data["patella_rotation"], z, atol=1e-9)
    np.testing.assert_allclose(data["patella_tilt"], -x, atol=1e-9)
    np.testing.assert_allclose(data["knee_flexion"], np.degrees(knee_flexion(result.times)), atol=1e-9)
    np.testing.assert_allclose(data["knee_adduction"], np.degrees(0.05), atol=1e-9)
    np.testing.assert_allclose(data["knee_internal_rotation"], np.degrees(-0.03), atol=1e-9)
    np.testing.assert_allclose(result.center, result.position, atol=1e-15)  # the button sits at the patella's origin


def test_knee_angles_with_a_moving_femur_agree_with_the_simulated_guide():
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(5)
    times = 0.01 * np.arange(12)

    def wobbling(first):
        steps = Rotation.from_rotvec(0.02 * rng.normal(size=(12, 3)))
        return PoseSeries(
            times, rng.normal(size=(12, 3)), (Rotation.from_rotvec(first) * steps).as_quat(scalar_first=True)
        )

    motion = KneeMotion.from_poses(wobbling([0.1, 0.5, -0.2]), wobbling([0.3, -0.6, 0.1]))
    guide = Guide.sample(motion, jnp.asarray(motion.times))
    q = Quaternion.from_rotation(guide.femur.rotation).conjugate() * Quaternion.from_rotation(guide.tibia.rotation)
    np.testing.assert_allclose(
        np.stack(tibiofemoral_angles(tibia_orientation(motion))), np.stack(tibiofemoral_angles(q)), atol=1e-10
    )


def test_energy_budget_adds_up(result, data):
    e = result.energies
    stored = sum(data[f"stored_energy_{name}"].values for name in e.stored)
    np.testing.assert_allclose(data["total_energy"], data["kinetic_energy"] + stored, atol=1e-15)
    change = data["total_energy"] - data["total_energy"][0]
    np.testing.assert_allclose(
        data["energy_budget_error"], change - data["work"] + data["heat"] + data["numerical_dissipation"], atol=1e-15
    )
    assert np.abs(data["energy_budget_error"]).max() < 0.05 * np.abs(change).max()


def test_a_file_says_how_fast_contacts_close(result, data):
    assert data.attrs["restitution"] == result.impact.describe()
    assert data.attrs["restitution"].startswith("contacts close at ")


def test_groove_offset_is_measured_from_the_bottom(result):
    np.testing.assert_allclose(result.groove[1], result.center[:, 1] - GROOVE_AT, atol=1e-9)
    assert not result.dislocations().dislocated.any()
    assert result.dislocations(threshold=1e-9).events[0].time == result.times[0]


def test_status_flags_are_readable(result, data):
    attributes = data["status"].attrs
    assert attributes["flag_meanings"].split() == [f.name.lower() for f in Status if f]
    assert list(attributes["flag_masks"]) == [int(f) for f in Status if f]
    flags = np.zeros_like(result.flags)
    flags[3:5] = Status.LEFT_PATCH | Status.NO_CONTACT
    flags[7] = Status.NOT_FINITE
    marked = dataclasses.replace(result, flags=flags)
    assert marked.status == Status.LEFT_PATCH | Status.NO_CONTACT | Status.NOT_FINITE
    assert f"2 of {flags.size} frames" in marked.summary()
    assert "outside the fitted surface" in marked.to_dataset().attrs["status"]
    assert "all frames clean" not in marked.summary()
    assert result.status == Status.OK
    assert "all frames clean" in result.summary()


def test_netcdf_round_trip(result, data, tmp_path):
    file = tmp_path / "run.nc"
    result.save(file)
    back = load_dataset(file)
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]
    assert set(back.variables) == set(data.variables)
    for name in data.variables:
        np.testing.assert_array_equal(back[name], data[name])
        assert back[name].attrs["units"] == data[name].attrs["units"]
    assert back.attrs["equilibrium"] == result.equilibrium.description


def test_csv_has_a_column_per_component_with_its_unit(result, tmp_path):
    file = tmp_path / "run.csv"
    result.to_csv(file)
    header, *rows = file.read_text().splitlines()
    assert len(rows) == result.times.size
    labels = header.split(",")
    assert {"sphere_center_x [m]", "patella_tilt [deg]", "patella_qw", "work [J]"} <= set(labels)
    column = labels.index("patella_tilt [deg]")
    tilt = [float(row.split(",")[column]) for row in rows]
    np.testing.assert_allclose(tilt, np.degrees(result.angles.tilt), rtol=1e-11)


def test_csv_is_read_back_in_si_units(result, tmp_path):
    file = tmp_path / "run.csv"
    result.to_csv(file)
    lines = [line.split(",") for line in file.read_text().splitlines()]
    kept = [i for i, label in enumerate(lines[0]) if "[J]" not in label]
    file.write_text("\n".join(",".join(line[i] for i in kept) for line in lines) + "\n")
    table = read_csv(file)
    i = table.names.index("patella_flexion")
    np.testing.assert_allclose(table.values[:, i], result.angles.flexion, rtol=1e-10)
    assert table.units["patella_flexion"] == "rad"


def test_sto_is_read_back_with_angles_in_radians(result, tmp_path):
    file = tmp_path / "run.sto"
    result.to_sto(file)
    assert "inDegrees=yes" in file.read_text()[:200]
    table = read_sto(file, rotational=["patella_flexion", "patella_tilt", "patella_rotation", "knee_*"])
    columns = dict(zip(table.names, table.values.T, strict=True))
    np.testing.assert_allclose(table.times, result.times, atol=1e-12)
    np.testing.assert_allclose(columns["patella_rotation"], result.angles.rotation, rtol=1e-10)
    np.testing.assert_allclose(columns["quadriceps_tension"], result.effects["quadriceps"]["tension"], rtol=1e-10)


@pytest.mark.parametrize("write", ["save", "to_csv", "to_sto"])
def test_unwritable_places_are_refused_and_nothing_is_left(result, write, tmp_path):
    with pytest.raises(OutputError, match=r"no folder .*absent; try: create it"):
        getattr(result, write)(tmp_path / "absent" / "run.nc")
    with pytest.raises(OutputError, match="is a folder"):
        getattr(result, write)(tmp_path)
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(OutputError, match="no folder"):
        getattr(result, write)(blocked / "run.nc")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_an_interrupted_write_keeps_the_old_file(tmp_path):
    file = tmp_path / "run.nc"
    file.write_text("old")

    def interrupted():
        with written_whole(file) as temporary:
            temporary.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match=r"run\.nc: cannot be written: No space left"):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]
    assert file.read_text() == "old"


def test_loading_what_is_no_result_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_dataset(tmp_path / "absent.nc")
    (tmp_path / "text.nc").write_text("not a dataset")
    with pytest.raises(InputError, match="cannot be read as NetCDF"):
        load_dataset(tmp_path / "text.nc")


def test_a_group_of_three_is_not_taken_for_x_y_z(result):
    effects = {**result.effects, "strands": {"tension": np.ones((result.times.size, 3))}}
    observables = {**result.observables, "strands": result.observables["quadriceps"]}
    grouped = dataclasses.replace(result, effects=effects, observables=observables, groups={"strands": 3})
    assert grouped.to_dataset()["strands_tension"].dims == ("time", "strands_element")


def test_equilibrium_on_both_facets_is_stable_and_agrees_with_the_run(result):
    report = pftwin.equilibrium(small_scene())
    assert report.converged
    assert report.kind == "stable"
    assert report.facets == ("medial", "lateral")
    assert "medial and the lateral facet at once" in report.description
    np.testing.assert_allclose(report.position, result.position[0], atol=1e-12)
    np.testing.assert_allclose(report.quaternion, result.equilibrium.quaternion, atol=1e-12)
    for name in ("contact", "quadriceps", "gravity"):  # the patellar tendon's end moves already in the run
        for key, value in result.equilibrium.effects[name].items():
            np.testing.assert_allclose(report.effects[name][key], value, rtol=1e-6, atol=1e-9, err_msg=f"{name} {key}")
    plain = report.to_dict()
    assert json.loads(json.dumps(plain))["facets"] == ["medial", "lateral"]


def _report(scene, residual, stiffness):
    pose = scene.center_of_mass_pose()
    solution = Solution(pose, (), jnp.asarray(residual), jnp.asarray(80), jnp.asarray(stiffness))
    there = (scene.start, {"contact": {"force_medial": np.array(1.0), "force_lateral": np.array(0.0)}}, 0)
    return EquilibriumReport.build(scene, solution, True, there=there)


def test_saddles_and_failures_are_called_so():
    scene = small_scene()
    saddle = _report(scene, 1e-9, np.diag([-3.0, 1, 2, 3, 4, 5]))
    assert saddle.kind == "saddle"
    assert saddle.description.startswith("saddle equilibrium on the medial facet alone, 0.00 mm and 0.00 deg")
    assert saddle.description.endswith("found by damped relaxation")
    assert _report(scene, 1e-9, np.diag([1e-9, 1, 2, 3, 4, 5])).kind == "neutral"
    failed = _report(scene, 3.0, np.full((6, 6), np.nan))
    assert failed.kind == "unknown"
    assert failed.description == "no equilibrium: the residual force is 3 N after 80 iterations"


def test_distance_from_the_start_pose():
    scene = small_scene()
    pose = scene.center_of_mass_pose()
    moved = dataclasses.replace(
        pose,
        position=pose.position + vec(0.003, 0.0, 0.004),
        orientation=pose.orientation * Quaternion.from_rotation_vector(vec(0.0, 0.2, 0.0)),
    )
    solution = Solution(moved, (), jnp.asarray(0.0), jnp.asarray(3), jnp.eye(6))
    report = EquilibriumReport.build(scene, solution, False, there=(scene.start, {}, 0))
    assert report.moved == pytest.approx(0.005)
    assert report.turned == pytest.approx(0.2)
    assert report.facets == ()
    assert "free of contact, 5.00 mm" in report.description


def test_nothing_of_a_result_is_a_jax_array(result):
    leaves = jax.tree.leaves([result.times, result.center, result.effects, result.flags, list(result.angles)])
    assert all(type(leaf) is np.ndarray for leaf in leaves)


def test_vectors_of_a_groups_elements_have_three_dimensions(result):
    n = result.times.size
    effects = {**result.effects, "strands": {"tension": np.ones((n, 4, 3)), "length": np.ones((n, 5))}}
    observables = {**result.observables, "strands": result.observables["quadriceps"]}
    data = dataclasses.replace(result, effects=effects, observables=observables, groups={"strands": 4}).to_dataset()
    assert data["strands_tension"].dims == ("time", "strands_element", "axis")
    assert data["strands_length"].dims == ("time", "strands_0_5")
