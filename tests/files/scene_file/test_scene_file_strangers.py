"""Scene files that are made to take for ever: refused before they do; what only looks like them is read."""

from __future__ import annotations

from pathlib import Path

import pytest
from at_once import at_once

from pftwin.base.errors import InputError
from pftwin.files.scene_file.document import DEEPEST, Document

N = 60_000
DEEP = ".".join(["a"] * N)
BELOW = ".".join(["a"] * DEEPEST)


def read(folder: Path, text: str) -> Document:
    (folder / "a.toml").write_text(text)
    return Document.read(folder / "a.toml")


@pytest.mark.parametrize(
    "text",
    [
        f"{DEEP} = 1",
        f"[{DEEP}]",
        f"[[ {DEEP.replace('.', ' . ')} ]]",
        f"x = {{{DEEP} = 1}}",
        ".".join(["'a'"] * N) + " = 1",
        ".".join(['"\\""', "a"] * (N // 2)) + " = 1",  # keys with a quote in them
        f'x = {{b = """\n \' """, {DEEP} = 1}}',  # behind what looks like the beginning of a string
        f"x = {{b = '''\n # ''', {DEEP} = 1}}",
        f"x = {{b = [ # \n {{{DEEP} = 1}}]}}",
        f"{BELOW}.a = 1",
        f"[{BELOW}]\na.b = 1",
        "x = " + "{a = " * DEEPEST + "1" + "}" * DEEPEST,
        "x = " + "[" * DEEPEST + "1" + "]" * DEEPEST,
    ],
)
def test_tables_in_tables_without_end(tmp_path, text):
    with at_once(), pytest.raises(InputError, match=r"a\.toml: tables within tables deeper than 32; expected: a few"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        (f'x = "{DEEP}"', DEEP),
        (f"x = '{DEEP}'", DEEP),
        (f'x = """\n{DEEP} = 1\n"""', f"{DEEP} = 1\n"),
        (f"# {DEEP} = 1\nx = 1", 1),
        (f"x = [{'0.5, ' * 100}]", [0.5] * 100),
        (f"x = 1 # {DEEP}", 1),
    ],
)
def test_dots_in_strings_comments_and_numbers_are_no_tables(tmp_path, text, value):
    assert read(tmp_path, text).data == {"x": value}


def test_the_deepest_that_is_read(tmp_path):
    inner = read(tmp_path, f"{BELOW} = 1").data
    for _ in range(DEEPEST):
        inner = inner["a"]
    assert inner == 1


@pytest.mark.parametrize("text", ['x = "' + N * '\\"', 'x = """' + N * '" ', "x = " + N * "\"'"])
def test_quotes_that_are_never_closed(tmp_path, text):
    with at_once(), pytest.raises(InputError, match="not valid TOML"):
        read(tmp_path, text)
