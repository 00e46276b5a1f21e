"""Tables on a terminal: whole words and numbers, whatever its width."""

from __future__ import annotations

import ast
import io
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from pftwin.base.sheet import Sheet

ROOT = Path(__file__).resolve().parents[2]
WORDS = st.text("abcdefghij.[]_-", min_size=1, max_size=18)
CELLS = st.lists(WORDS, max_size=6).map(" ".join)
NUMBERS = st.sampled_from(["0", "-12.34", "1.23 ± 0.05", "51.6 (50.1 to 52.0)", "lateral at 15 deg", "-"])


def printed(sheet: Sheet, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, soft_wrap=True)
    console.print(*sheet.tables(console.width), sep="\n")
    return console.file.getvalue()


@st.composite
def sheets(draw: st.DrawFn) -> Sheet:
    """Up to 14 columns, of words or of numbers; up to five of them name the row."""
    n, keys = draw(st.integers(6, 14)), draw(st.integers(1, 5))
    left = tuple(i for i in range(n) if draw(st.booleans()))
    rows = draw(st.lists(st.tuples(*(CELLS if i in left else NUMBERS for i in range(n))), max_size=4))
    headings = draw(st.lists(CELLS, min_size=n, max_size=n))
    groups = tuple("ab"[i % 2] for i in range(len(rows)))
    return Sheet("", tuple(headings), tuple(rows), groups, left, keys=keys)


def pieces(sheet: Sheet) -> list[str]:
    """What must stay in one piece: words, and numbers with what stands beside them."""
    left = range(len(sheet.headings)) if sheet.words is None else sheet.words
    found = [word for heading in sheet.headings for word in heading.split()]
    for row in sheet.rows:
        for i, cell in enumerate(row):
            found += cell.split() if i in left else [cell]
    return found


@settings(deadline=None)
@given(sheets())
def test_nothing_is_cut_broken_or_lost_at_80_columns(sheet):
    text = printed(sheet, 80)
    assert "…" not in text
    assert max(map(len, text.splitlines()), default=0) <= 80
    for piece in pieces(sheet):
        assert piece in text


@settings(deadline=None)
@given(sheets())
def test_each_table_begins_with_the_columns_that_name_its_rows(sheet):
    parts = sheet.tables(80)
    headings = [[" ".join(str(c.header).replace("\\", "").split()) for c in table.columns] for table in parts]
    names = [" ".join(h.replace("\\", "").split()) for h in sheet.headings]
    numbered = headings[0][0] == "row"
    keys, rest = (["row"], names) if numbered else (names[: sheet.keys], names[sheet.keys :])
    assert all(part[: len(keys)] == keys for part in headings)
    assert rest == [h for part in headings for h in part[len(keys) :]]
    assert {table.row_count for table in parts} == {len(sheet.rows)}


def test_a_table_with_room_is_one_in_a_frame():
    sheet = Sheet("what came out", ("case", "force [N]", "depth"), (("1", "20.5", "3"), ("2", "3", "1")), words=(0,))
    [table] = sheet.tables(80)
    assert printed(sheet, 80).splitlines()[3:5] == ["┡━━━━━━╇━━━━━━━━━━━╇━━━━━━━┩", "│ 1    │      20.5 │     3 │"]
    assert table.title == "what came out"
    assert [t.title for t in sheet.tables(14)] == ["what came out", ""]


def test_rows_are_numbered_where_what_names_them_leaves_no_room():
    keys = ("external_rotation", "patellar_tendon_length", "tuberosity_transfer_medial")
    sheet = Sheet("", (*keys, "offset [mm]"), (("1", "2", "3", "-5.1 (-6.2 to -3.1)"),), words=(), keys=3)
    assert [str(t.columns[0].header) for t in sheet.tables(120)] == ["external_rotation"]
    lines = [re.sub("[│┃]", "", line).split() for line in printed(sheet, 80).splitlines()]
    assert [line for line in lines if "-5.1" in line] == [["1", "-5.1", "(-6.2", "to", "-3.1)"]]
    assert [line for line in lines if "row" in line] == [["row", *keys], ["row", "offset", "[mm]"]]


def test_a_word_wider_than_the_terminal_is_broken_but_complete():
    path = "/".join(["a-long-folder-name"] * 6)
    text = printed(Sheet("", ("file", "bytes"), ((path, "123"),), words=(0,)), 80)
    assert re.sub(r"\s", "", text).replace("123", "", 1).endswith(path)
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("package", ["pftwin", "fitting"])
def test_commands_have_no_other_tables(package):
    """What holds for a sheet then holds for every table that a command prints."""
    for file in (ROOT / package).rglob("*.py"):
        modules = {n.module for n in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(n, ast.ImportFrom)}
        assert "rich.table" not in modules or file.name == "sheet.py", file
