"""Damaged files are read or refused in words, by every reader; and what fuzzing has once found stays mended.

`python -m fuzz.run_fuzz --count 10000` in the folder tests tries more.
"""

from __future__ import annotations

import random
import struct

import pytest
from fuzz.judge import verdict
from fuzz.mutations import VALUES, mutated
from fuzz.readers import FORMATS, reader
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pftwin.base.errors import InputError
from pftwin.files.mocap.c3d import check_c3d_structure
from pftwin.files.scene_file.document import Document

# A crash of ezc3d or HDF5 would end the whole run of tests: these are left to the script, which takes processes.
IN_C = ("c3d", "c3d_channels", "result")
SLOW = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large)


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    made = {}

    def of(name):
        if name not in made:
            (folder / name).mkdir()
            made[name] = reader(name, folder / name)
        return made[name], folder / name

    return of


@pytest.mark.filterwarnings("ignore::pftwin.base.errors.PftwinWarning")
@pytest.mark.parametrize("name", FORMATS)
def test_the_valid_file_is_read(readers, name):
    one, folder = readers(name)
    file = folder / f"valid{one.suffix}"
    file.write_bytes(one.valid)
    assert one.read(file) is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", [f for f in FORMATS if f not in IN_C])
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=SLOW, database=None)
@given(seed=st.integers(0, 2**63))
def test_a_damaged_file_is_read_or_refused(readers, name, seed):
    one, folder = readers(name)
    assert verdict(one, mutated(one.valid, random.Random(seed)), folder) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["estimate", "checkpoint", "strands"])
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=SLOW, database=None)
@given(content=st.recursive(st.sampled_from(VALUES), lambda v: st.lists(v) | st.dictionaries(st.text(), v)))
def test_any_json_is_read_or_refused(readers, name, content):
    import json

    one, folder = readers(name)
    assert verdict(one, json.dumps(content).encode(), folder) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["estimate", "checkpoint", "strands"])
def test_lists_within_lists_without_end_are_refused(readers, name):
    one, folder = readers(name)
    file = folder / "deep.json"
    file.write_bytes(b"[" * 100_000)
    with pytest.raises(InputError, match=r"deep\.json: lists within lists without end"):
        one.read(file)


@pytest.mark.parametrize(
    ("value", "problem"),
    [("9" * 5000, "Exceeds the limit .*digits"), ("[" * 100_000, "lists within lists without end")],
)
def test_a_scene_file_that_the_parser_cannot_take(tmp_path, value, problem):
    (tmp_path / "scene.toml").write_text(f"schema = {value}\n")
    with pytest.raises(InputError, match=rf"scene\.toml: not readable TOML: {problem}"):
        Document.read(tmp_path / "scene.toml")


def test_a_text_too_long_for_a_name_is_no_file_of_the_scene(tmp_path):
    (tmp_path / "scene.toml").write_text(f'schema = 1\nname = "{"9" * 5000}"\n')
    assert Document.read(tmp_path / "scene.toml").files() == (tmp_path / "scene.toml",)


def records(content: bytes):
    """Begin of the data of each parameter of a C3D file."""
    at = (content[0] - 1) * 512 + 4
    while True:
        length, group = struct.unpack_from("2b", content, at)
        link = at + 2 + abs(length)
        step = struct.unpack_from("<h", content, link)[0]
        if group > 0:
            yield content[at + 2 : link], link + 2
        if step == 0 or length == 0:
            return
        at = link + step


@pytest.mark.parametrize(
    ("parameter", "offset", "byte"),
    [
        (b"LABELS", 2, 255),  # more text than the record has: ezc3d read beyond its end
        (b"RATIO", 1, 255),  # more dimensions than there are
        (b"DESCRIPTIONS", 1, 0),  # a text without dimensions
        (b"USED", 0, 3),  # no such type
    ],
)
def test_a_c3d_file_whose_parameters_lie_is_refused(readers, parameter, offset, byte):
    one, _ = readers("c3d")
    changed = bytearray(one.valid)
    begin = next(begin for name, begin in records(one.valid) if name == parameter)
    changed[begin + offset] = byte
    with pytest.raises(InputError, match=r"a\.c3d: the parameter section of this C3D file is damaged"):
        check_c3d_structure(bytes(changed), where="a.c3d")
