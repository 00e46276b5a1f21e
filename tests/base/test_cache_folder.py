"""What is kept comes back unharmed, or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pftwin.base import cache_folder as folder
from pftwin.base.errors import PftwinWarning


@pytest.fixture
def place(tmp_path):
    before = folder.chosen()
    folder.use_cache_folder(tmp_path)
    yield tmp_path
    folder.use_cache_folder(before)


def test_what_was_kept_is_read(place):
    folder.write("things", "a", b"content")
    assert folder.read("things", "a") == b"content"
    assert folder.read("things", "b") is None
    assert [p.name for p in (place / "things").iterdir()] == ["a"]  # no temporary file is left


def test_without_a_folder_nothing_is_kept(place):
    folder.use_cache_folder(None)
    folder.write("things", "a", b"content")
    assert folder.read("things", "a") is None
    assert list(place.iterdir()) == []


def test_a_folder_that_cannot_be_written_to_is_a_warning(place):
    (place / "things").write_text("a file where the folder would be")
    with pytest.warns(PftwinWarning, match="nothing can be kept here"):
        folder.write("things", "a", b"content")


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
