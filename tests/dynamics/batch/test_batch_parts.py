"""A batch's folder of parts: what is there is kept, what is damaged or of another batch is never taken."""

from __future__ import annotations

import json
import os
import time

import jax.numpy as jnp
import numpy as np
import pytest
from cheap_batch import COUNT, UNIT, batch, digest, made_cheap
from small_scene import small_scene

from pftwin import simulate_batch
from pftwin.base.errors import InputError, OutputError, PftwinWarning
from pftwin.dynamics.batch import plan
from pftwin.dynamics.batch.member import Task
from pftwin.dynamics.batch.parts import missing_parts, read_parts
from pftwin.dynamics.batch.simulate_batch import unit_for


@pytest.fixture
def cheap(monkeypatch):
    return made_cheap(monkeypatch.setattr)


@pytest.fixture
def filled(cheap, tmp_path):
    """A folder with all five parts."""
    batch(parts=tmp_path)
    cheap.rows.clear()
    return tmp_path


def test_parts_are_the_batch_in_files_that_anyone_can_read(cheap, filled):
    import xarray as xr

    whole = batch()
    assert batch(parts=filled).identical(whole)
    assert cheap.rows == [COUNT]
    assert digest(read_parts(filled)) == digest(whole)
    assert read_parts(filled).attrs == pytest.approx(whole.attrs)
    with xr.open_dataset(filled / "part_00001.nc") as part:
        assert part["variant"].values.tolist() == list(range(UNIT, 2 * UNIT))
        np.testing.assert_array_equal(part["mean_shift"], whole["mean_shift"][UNIT : 2 * UNIT])
        assert part["mean_shift"].units == "m"


def test_only_what_is_missing_is_computed(cheap, filled):
    before = {p.name: p.stat().st_mtime_ns for p in filled.iterdir()}
    for name in ("part_00001.nc", "part_00004.nc"):
        (filled / name).unlink()
    assert list(missing_parts(filled)) == [1, 4]
    calls = []
    assert digest(batch(parts=filled, progress=lambda *a: calls.append(a))) == digest(batch())
    assert cheap.rows == [UNIT, UNIT, COUNT]
    assert calls == [(UNIT, 2 * UNIT), (2 * UNIT, 2 * UNIT)]
    assert [n for n, at in before.items() if (filled / n).stat().st_mtime_ns == at] == [
        n for n in before if n not in ("part_00001.nc", "part_00004.nc")
    ]


def test_what_is_there_can_be_read_before_all_is(filled):
    (filled / "part_00002.nc").unlink()
    with pytest.raises(InputError, match=r"1 of 5 parts are missing or damaged: part_00002\.nc .*no such file.*only"):
        read_parts(filled)
    some = read_parts(filled, incomplete=True)
    assert some["variant"].values.tolist() == [*range(240), *range(360, 600)]
    assert some.attrs["title"] == "batch of 480: small knee"


def truncated(path):
    path.write_bytes(path.read_bytes()[:-200])


def emptied(path):
    path.write_bytes(b"")


def altered(path):
    """One number, by a program that writes sound NetCDF."""
    import h5py

    with h5py.File(path, "r+") as file:
        file["mean_shift"][3] += 1e-12


def exchanged(path):
    path.write_bytes(path.with_name("part_00000.nc").read_bytes())


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (truncated, "cannot be read as NetCDF|is damaged"),
        (emptied, "cannot be read as NetCDF"),
        (altered, "its numbers are not those that were written; try: the same call again recomputes this part"),
        (exchanged, "belongs to another batch, or to another place in it"),
    ],
)
def test_a_damaged_part_is_reported_and_computed_anew(cheap, filled, harm, words):
    harm(filled / "part_00003.nc")
    with pytest.raises(InputError, match=r"1 of 5 parts are missing or damaged: part_00003\.nc"):
        read_parts(filled)
    with pytest.warns(PftwinWarning, match=rf"part_00003\.nc: ({words}).*it is computed anew now"):
        found = batch(parts=filled)
    assert cheap.rows == [UNIT]
    assert digest(found) == digest(batch())
    assert missing_parts(filled) == {}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"dt": 2e-3}, "with other scenes and settings"),  # substeps are numbers of the scenes
        ({"care": False}, "with other settings"),
        ({"chunk": 240}, "with other settings"),
        ({"rows": np.ones((COUNT, 2))}, "with other members"),
    ],
)
def test_parts_of_another_batch_are_refused(filled, changed, words):
    with pytest.raises(InputError, match=f"holds parts of another batch, {words}; expected: .*try: another folder"):
        batch(parts=filled, **changed)


def test_folders_that_cannot_be(cheap, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file: is a file; try: another folder"):
        batch(parts=tmp_path / "file")
    with pytest.raises(OutputError, match="there is no folder"):
        batch(parts=tmp_path / "not" / "there")
    (tmp_path / "part_00000.nc").write_text("")
    with pytest.raises(InputError, match=r"holds parts and no batch\.json; expected: an empty folder"):
        batch(parts=tmp_path)
    (tmp_path / "batch.json").write_text('{"format": "a cohort"}')
    with pytest.raises(InputError, match=r"batch\.json: not a batch: its format is 'a cohort'; expected: a file of"):
        batch(parts=tmp_path)
    with pytest.raises(InputError, match=r"nowhere.*batch\.json"):
        read_parts(tmp_path / "nowhere")
    assert cheap.rows == []


def test_what_a_kill_left_half_written_goes_after_an_hour(filled):
    old, new = filled / ".part_00001.abcdefgh.nc", filled / ".part_00001.abcdefgi.nc"
    for path in (old, new):
        path.write_text("")
    os.utime(old, (time.time() - 4000,) * 2)
    batch(parts=filled)
    assert not old.exists()
    assert new.exists(), "another process may be writing it"


def test_shares_fill_one_folder(cheap, tmp_path):
    whole = batch()
    cheap.rows.clear()
    first, second = (batch(parts=tmp_path, share=(k, 2)) for k in range(2))
    assert cheap.rows == [UNIT] * 5
    assert first["variant"].values.tolist() == [*range(120), *range(240, 360), *range(480, 600)]
    np.testing.assert_array_equal(second["mean_tilt"], whole["mean_tilt"][second["variant"].values])
    assert batch(parts=tmp_path).identical(whole)
    assert cheap.rows == [UNIT] * 5


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"share": (0, 2)}, "share: no folder to share; expected: parts= with a folder"),
        ({"share": (2, 2), "parts": "x"}, r"share: found \(2, 2\); expected: \(k, n\) with k of 0 to n - 1"),
        ({"share": 3, "parts": "x"}, "share: found 3"),
    ],
)
def test_shares_that_make_no_sense(more, words):
    with pytest.raises(InputError, match=words):
        batch(**more)


def test_scenes_of_several_structures_come_back_in_their_order(cheap, tmp_path):
    scenes = [small_scene(6 if i % 3 else 5) for i in range(40)]
    whole = simulate_batch(scenes, dt=5e-3)
    assert simulate_batch(scenes, dt=5e-3, parts=tmp_path, chunk=1).identical(whole)
    assert digest(read_parts(tmp_path)) == digest(whole)


@pytest.mark.parametrize(
    ("total", "piece", "members", "files"),
    [
        (100, 16, 1_920, 1),
        (3_840, 120, 1_920, 2),
        (100_000, 120, 1_920, 53),
        (10**6, 120, 15_600, 65),
        (10**7, 120, 30_720, 326),
        (10**6, 2048, 14_336, 70),
    ],
)
def test_parts_are_neither_many_nor_small(total, piece, members, files):
    assert unit_for(total, piece) == members
    assert -(-total // members) == files


def test_another_function_is_another_batch():
    """Whatever a change looks up is part of the program that is traced."""
    scene, row = small_scene(5), np.ones(2)
    factor = [1.0]

    def change(scene, row):
        tendon = scene.effects[1]
        return scene.with_effect(type(tendon)(**{**vars(tendon), "stiffness": row[0] * factor[0]}))

    def program():
        plan._text.cache_clear()
        task = Task(scene, change, jnp.asarray(2), "symplectic_euler", False, False, None)
        return plan._traced(_changed, (task, row))[0]

    first = program()
    assert program() == first
    factor[0] = 2.0
    assert program() != first


def _changed(task, row):
    return task.change(task.scene, row).effects[1].stiffness


def test_the_index_says_what_the_batch_is(filled):
    said = json.loads((filled / "batch.json").read_text())
    assert said["units"] == [UNIT] * 5
    assert set(said["features"]) == {"scenes", "program", "members", "settings", "platform", "versions"}


def test_a_share_for_which_no_part_is_left_is_refused(cheap, tmp_path):
    """Five parts: the sixth of eight jobs, counted from 0, has nothing to do; the fifth has."""
    with pytest.raises(InputError, match="share: share 5 of 5 parts, counted from 0; expected: a number below 5"):
        batch(parts=tmp_path, share=(5, 8))
    assert batch(parts=tmp_path, share=(4, 8))["variant"].values.tolist() == [*range(480, 600)]
