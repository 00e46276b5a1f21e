"""Files written whole: on the disk before they take their place, and nothing left behind where that fails."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pftwin.base import output
from pftwin.base.errors import OutputError
from pftwin.base.output import written_whole
from pftwin.base.text_files import write_json_file
from pftwin.cli.terminal import write_json


@pytest.mark.skipif(os.name != "posix", reason="folders are not opened elsewhere")
def test_content_is_on_the_disk_before_the_name(tmp_path, monkeypatch):
    steps = []
    sync, replace = output._on_disk, Path.replace

    def synced(path: Path) -> None:
        steps.append("folder" if path.is_dir() else f"file of {path.stat().st_size} bytes")
        sync(path)

    def replaced(path: Path, target: Path) -> None:
        steps.append("name")
        replace(path, target)

    monkeypatch.setattr(output, "_on_disk", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    with written_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("123")
    assert steps == ["file of 3 bytes", "name", "folder"]


def test_a_disk_that_does_not_take_it_leaves_the_old_file(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(OutputError, match=r"a\.txt: cannot be written: No space left on device"),
        written_whole(tmp_path / "a.txt") as temporary,
    ):
        temporary.write_text("new")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "old")]


def test_a_file_system_that_cannot_sync_folders_will_do(tmp_path, monkeypatch):
    sync = os.fsync

    def fussy(handle: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{handle}") or os.path.isdir(f"/dev/fd/{handle}"):
            raise OSError(22, "Invalid argument")
        sync(handle)

    monkeypatch.setattr(os, "fsync", fussy)
    with written_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "a.txt").read_text() == "new"


def test_what_json_has_no_type_for_is_text_on_the_terminal_and_an_error_in_files(tmp_path, capsys):
    """A file that is read back must not hold the text of an object."""
    with pytest.raises(TypeError, match="not JSON serializable"):
        write_json_file(tmp_path / "estimate.json", {"method": Path("a") / "b"})
    assert not list(tmp_path.iterdir())
    write_json({"where": Path("a") / "b", "share": float("nan")}, "-")
    assert json.loads(capsys.readouterr().out) == {"where": str(Path("a") / "b"), "share": None}
