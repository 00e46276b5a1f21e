"""What is kept comes back unharmed, or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import jax
import pytest

from pftwin.base import cache_folder as folder
from pftwin.base.errors import PftwinWarning
from pftwin.base.runtime import configure


@pytest.fixture
def place(tmp_path):
    before = folder.chosen()
    folder.use_cache_folder(tmp_path)
    yield tmp_path
    folder.use_cache_folder(before)


def test_a_stored_value_is_read_back(place):
    folder.write("things", "a", b"content")
    assert folder.read("things", "a") == b"content"
    assert folder.read("things", "b") is None
    assert [p.name for p in (place / "things").iterdir()] == ["a"]  # no temporary file is left


def test_without_a_folder_nothing_is_stored(place):
    folder.use_cache_folder(None)
    folder.write("things", "a", b"content")
    assert folder.read("things", "a") is None
    assert not [path for path in place.rglob("*") if path.is_file()]


def test_a_folder_that_cannot_be_written_to_is_a_warning(place):
    (place / "things").write_text("a file where the folder would be")
    with pytest.warns(PftwinWarning, match="nothing can be stored here"):
        folder.write("things", "a", b"content")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("a file", "is no folder"),
        ("a file/below", "is no folder"),
        ("/dev/null", "is no folder"),
        ("/dev/full/below", "is no folder"),
        ("a link to itself", "is no folder"),
        ("x" * 300, "cannot be used"),
        ("zero\0byte", "cannot be used"),
        ("compiled is a file", "is no folder"),
        ("/proc/none/such", "cannot be used"),
    ],
)
def test_where_there_can_be_no_folder_is_a_warning(tmp_path, name, why):
    (tmp_path / "a file").write_text("a file where the folder would be")
    (tmp_path / "a link to itself").symlink_to(tmp_path / "a link to itself")
    (tmp_path / "compiled is a file").mkdir()
    folder.compiled_folder(tmp_path / "compiled is a file").write_text("")
    before, cache = folder.chosen(), jax.config.jax_compilation_cache_dir
    try:
        with pytest.warns(PftwinWarning, match=f"{why}.*; nothing is cached; try: a folder that you may write to"):
            configure(cache_dir=tmp_path / name)
        assert folder.chosen() is None
        assert jax.config.jax_compilation_cache_dir == cache
        folder.write("things", "a", b"content")
        assert folder.read("things", "a") is None
    finally:
        folder.use_cache_folder(before)


def test_a_file_under_another_name_is_not_taken_for_it(place):
    folder.write("things", "a", b"content")
    folder.write("others", "c", b"content")
    (place / "things" / "b").write_bytes((place / "things" / "a").read_bytes())
    (place / "others" / "a").write_bytes((place / "things" / "a").read_bytes())
    assert folder.read("things", "b") is None
    assert folder.read("others", "a") is None
    assert folder.read("things", "a") == b"content"
    folder.write("things", "b", b"mended")
    assert folder.read("things", "b") == b"mended"


def test_what_was_not_used_for_longest_makes_room(place, monkeypatch):
    for i, name in enumerate("abcd"):
        folder.write("things", name, bytes(1000))
        os.utime(place / "things" / name, (i, i))
    folder.read("things", "a")  # used now
    monkeypatch.setattr(folder, "MOST", 4100)
    folder.write("things", "e", bytes(1000))
    assert sorted(os.listdir(place / "things")) == ["a", "e"]


def test_processors_do_not_share_compiled_programs(tmp_path, monkeypatch):
    """A program for one processor may hold instructions that another one lacks."""
    found = []
    for flags in ("sse avx", "sse avx avx512f"):
        folder.compiled_folder.cache_clear()
        monkeypatch.setattr(Path, "read_text", lambda *_, flags=flags: f"processor: 0\nflags : {flags}\n\n")
        found.append(folder.compiled_folder(tmp_path))
    folder.compiled_folder.cache_clear()
    assert found[0] != found[1]
