"""What is kept comes back unharmed, or not at all."""

from __future__ import annotations

import os

import pytest

from pftwin.errors import PftwinWarning
from pftwin.kept import folder


@pytest.fixture
def place(tmp_path):
    before = folder.chosen()
    folder.use(tmp_path)
    yield tmp_path
    folder.use(before)


def test_what_was_kept_is_read(place):
    folder.write("things", "a", b"content")
    assert folder.read("things", "a") == b"content"
    assert folder.read("things", "b") is None
    assert [p.name for p in (place / "things").iterdir()] == ["a"]  # no temporary file is left


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b[:3], lambda b: b"", lambda b: b[:-1] + b"x"])
def test_a_damaged_file_is_no_file(place, damage):
    folder.write("things", "a", b"content")
    path = place / "things" / "a"
    path.write_bytes(damage(path.read_bytes()))
    assert folder.read("things", "a") is None


def test_without_a_folder_nothing_is_kept(place):
    folder.use(None)
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
    monkeypatch.setattr(folder, "MOST", 4500)
    folder.write("things", "e", bytes(1000))
    assert sorted(os.listdir(place / "things")) == ["a", "e"]
