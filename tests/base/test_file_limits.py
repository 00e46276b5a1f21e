"""Files over their limits are refused before memory is taken for what they announce."""

from __future__ import annotations

import os

import h5py
import numpy as np
import pytest

from fitting.estimate import Estimate
from fitting.methods.problem import load_checkpoint
from pftwin.base import text_files as file_limits
from pftwin.base.errors import InputError
from pftwin.base.text_files import read_json
from pftwin.files.interchange.osim_document import read_osim
from pftwin.files.mocap import read_csv, read_markers, read_sto
from pftwin.files.result_files import load_dataset, save_dataset
from pftwin.files.scene_file import load_scene


def large(path, size):
    """A file of that size without content."""
    with path.open("wb") as file:
        file.truncate(size + 1)
    return path


@pytest.mark.parametrize(
    ("name", "read", "limit"),
    [
        ("scene.toml", load_scene, file_limits.SCENE_BYTES),
        ("a.trc", read_markers, file_limits.RECORDING_BYTES),
        ("a.c3d", read_markers, file_limits.RECORDING_BYTES),
        ("a.csv", read_csv, file_limits.RECORDING_BYTES),
        ("a.sto", read_sto, file_limits.RECORDING_BYTES),
        ("a.osim", read_osim, file_limits.MODEL_BYTES),
        ("fit.json", Estimate.load, file_limits.JSON_BYTES),
        ("checkpoint.json", lambda path: load_checkpoint(path, "problem"), file_limits.JSON_BYTES),
    ],
)
def test_too_large_a_file(tmp_path, name, read, limit):
    with pytest.raises(
        InputError, match=rf"^{tmp_path}/{name}: [\d.]+ MiB is too large; expected: at most {limit // 2**20} MiB; try: "
    ):
        read(large(tmp_path / name, limit))


def test_too_large_a_result(tmp_path):
    with pytest.raises(InputError, match=r"a\.nc: 4\.0 GB are too large; expected: at most 4 GB; try: fewer variants"):
        load_dataset(large(tmp_path / "a.nc", file_limits.RESULT_BYTES))


def test_a_device_is_no_file():
    with pytest.raises(InputError, match=r"^/dev/zero: is a device or a pipe; expected: a file"):
        read_json("/dev/zero", expected="an estimate")


def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    with pytest.raises(InputError, match="is a device or a pipe"):
        read_csv(tmp_path / "a.csv")


class TestNetCDF:
    @pytest.fixture
    def file(self, tmp_path):
        with h5py.File(tmp_path / "a.nc", "w") as opened:
            opened["time"] = np.arange(3.0)
        return tmp_path / "a.nc"

    @staticmethod
    def refusal(file):
        with pytest.raises(InputError) as caught:
            load_dataset(file)
        return str(caught.value)

    def test_a_variable_that_is_announced_and_not_there(self, file):
        with h5py.File(file, "a") as opened:
            opened.create_dataset("big", shape=(10**8,), dtype="f8", chunks=(10**5,))
        assert "'big' announces 800 MB, of which the file holds 0.0" in self.refusal(file)

    def test_zeros_packed_a_thousandfold(self, file):
        with h5py.File(file, "a") as opened:
            opened.create_dataset("big", data=np.zeros(10**7), compression="gzip")
        assert file.stat().st_size < 10**6
        assert "'big' announces 80 MB" in self.refusal(file)

    def test_more_than_any_result_has(self, file):
        with h5py.File(file, "a") as opened:
            opened.create_dataset("big", shape=(10**6, 10**6), dtype="f8", chunks=(100, 100))
        assert "8000.0 GB of variables are too large; expected: at most 4 GB" in self.refusal(file)

    def test_numbers_from_another_file(self, file, tmp_path):
        (tmp_path / "secret").write_bytes(bytes(800))
        with h5py.File(file, "a") as opened:
            opened.create_dataset("big", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
        assert "'big' is stored in another file; expected: a result saved by pftwin" in self.refusal(file)

    def test_a_link_to_another_file(self, file):
        with h5py.File(file, "a") as opened:
            opened["big"] = h5py.ExternalLink("other.nc", "/time")
        assert "'big' is stored in another file" in self.refusal(file)

    @pytest.mark.parametrize(("at", "value"), [(8, 0x10FF), (8, 2**40), (24, 2**64 - 8), (24, 0), (8, 8)])
    def test_a_damaged_heap_in_which_the_library_would_go_round_in_circles(self, tmp_path, at, value):
        from xarray import Dataset

        file = tmp_path / "a.nc"
        save_dataset(Dataset({"x": ("time", np.arange(3.0))}, {"time": np.arange(3.0)}), file)
        assert load_dataset(file)["x"].size == 3
        data = bytearray(file.read_bytes())
        heap = data.rindex(b"GCOL")
        if at == 24:
            data[heap + 16] = 0  # free, and of no room
        data[heap + at : heap + at + 8] = value.to_bytes(8, "little")
        file.write_bytes(data)
        assert f"the heap at byte {heap} is damaged" in self.refusal(file)
