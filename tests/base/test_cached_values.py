"""Values derived from files: once for each content, arguments and code."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from pftwin.base import cache_folder as folder
from pftwin.base import program_cache as values
from pftwin.base.errors import PftwinWarning
from pftwin.base.program_cache import cached

CALLS = []


def size(path: str, times: int = 1) -> int:
    CALLS.append(path)
    return times * len(Path(path).read_text())


def worried(path: str) -> int:
    warnings.warn("an odd file", PftwinWarning, stacklevel=2)
    return size(path)


@pytest.fixture
def place(tmp_path, monkeypatch):
    before = folder.chosen()
    folder.use_cache_folder(tmp_path / "kept")
    # Functions of a test are code from elsewhere; here they stand for pftwin's own.
    for function in (size, worried):
        monkeypatch.setattr(function, "__module__", "pftwin.tested")
    monkeypatch.setattr(values, "_source", lambda _: "source")
    CALLS.clear()
    yield tmp_path
    folder.use_cache_folder(before)


def test_a_value_is_derived_once(place):
    file = place / "a.txt"
    file.write_text("four")
    assert [cached(size, str(file), files=[file]) for _ in range(3)] == [4, 4, 4]
    assert len(CALLS) == 1
    assert cached(size, str(file), 2, files=[file]) == 8  # other arguments


def test_another_content_is_another_value(place):
    file = place / "a.txt"
    for text in ("four", "fourfour"):
        file.write_text(text)
        assert cached(size, str(file), files=[file]) == len(text)
    assert len(CALLS) == 2


def test_other_code_is_another_value(place, monkeypatch):
    file = place / "a.txt"
    file.write_text("four")
    for source in ("old", "new"):
        monkeypatch.setattr(values, "_source", lambda _, source=source: source)
        cached(size, str(file), files=[file])
    assert len(CALLS) == 2


def test_a_damaged_value_is_derived_anew(place):
    file = place / "a.txt"
    file.write_text("four")
    cached(size, str(file), files=[file])
    (path,) = (place / "kept" / "values").iterdir()
    folder.write("values", path.name, b"whole, but no value")
    assert cached(size, str(file), files=[file]) == 4
    assert len(CALLS) == 2
    path.write_bytes(path.read_bytes()[:20])
    assert cached(size, str(file), files=[file]) == 4
    assert len(CALLS) == 3


def test_warnings_come_every_time(place):
    file = place / "a.txt"
    file.write_text("four")
    for _ in range(2):
        with pytest.warns(PftwinWarning, match="odd file"):
            assert cached(worried, str(file), files=[file]) == 4
    assert len(CALLS) == 2


def test_code_from_elsewhere_is_not_cached(tmp_path):
    before = folder.chosen()
    folder.use_cache_folder(tmp_path / "kept")
    try:
        file = tmp_path / "a.txt"
        file.write_text("four")
        CALLS.clear()
        assert [cached(size, str(file), files=[file]) for _ in range(2)] == [4, 4]
    finally:
        folder.use_cache_folder(before)
    assert len(CALLS) == 2
    assert not (tmp_path / "kept" / "values").exists()


def test_a_missing_file_is_the_functions_own_error(place):
    with pytest.raises(FileNotFoundError):
        cached(size, str(place / "none"), files=[place / "none"])
