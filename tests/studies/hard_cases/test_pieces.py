"""Pieces of the matrix that were run at different times, put together."""

from __future__ import annotations

import json

import pytest

from pftwin.base.errors import InputError
from pftwin.studies.hard_cases import CONTACTS, INTEGRATORS, case_named, method_named, whole
from pftwin.studies.hard_cases.batch import batches, short_enough
from pftwin.studies.hard_cases.matrix import EVERYTHING
from pftwin.studies.hard_cases.table import MatrixPiece, merged_pieces, read_piece, read_pieces, runs
from pftwin.studies.hard_cases.verdict import Cell

MACHINE = {"cpu": "a", "cores": 1, "jax": "0", "date": "2026-01-01T10:00+00:00"}


def piece(outcome: str, *cases: str) -> MatrixPiece:
    return MatrixPiece(tuple(Cell(c, "P5", "newmark", "float64", outcome, "") for c in cases), 60.0, MACHINE, True)


def test_of_cells_run_twice_the_later_counts():
    found = merged_pieces(
        [piece("fail", "b", "a"), piece("pass", "b")], (("a", "b"), ("P5",), ("newmark",), ("float64",))
    )
    assert [(c.case, c.outcome) for c in found] == [("a", "fail"), ("b", "pass")]


def test_a_piece_is_read_as_it_was_written(tmp_path):
    path, wanted = tmp_path / "piece.json", piece("pass", "a", "b")
    path.write_text(json.dumps(wanted.as_dict()), encoding="utf-8")
    assert read_piece(path) == wanted
    assert runs([wanted]).rows == (("2026-01-01T10:00", "1.0", "P5", "newmark", "float64", "2", "the run alone"),)


def test_each_piece_states_what_was_checked(tmp_path):
    path = tmp_path / "piece.json"
    for truths, words in ((True, "everything"), (False, "everything but converged runs")):
        whole_piece = piece("pass", "a")._replace(quick=False, truths=truths)
        path.write_text(json.dumps(whole_piece.as_dict()), encoding="utf-8")
        assert runs([read_piece(path)]).rows[0][-1] == words


def test_pieces_of_a_folder_come_from_the_oldest_to_the_newest(tmp_path):
    newer = {**MACHINE, "date": "2026-02-01T10:00+00:00"}
    made = {"a": piece("pass", "b")._replace(machine=newer), "b": piece("fail", "b"), "c": piece("pass", "a")}
    for name, one in made.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(one.as_dict()), encoding="utf-8")
    assert read_pieces(tmp_path) == [made["b"], made["c"], made["a"]]
    assert read_pieces(tmp_path / "b.json") == [made["b"]]


def test_a_folder_without_a_piece_is_refused(tmp_path):
    with pytest.raises(InputError, match="no piece in it"):
        read_pieces(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no such file"),
        ("{", "line 1: not valid JSON"),
        ("{}", "no piece of the matrix: 'rows'"),
        ('{"rows": [{"name": 1}]}', "no piece of the matrix: .*'name'"),
        ("[]", "no piece of the matrix"),
        ('{"rows": []}', "no piece of the matrix: 'seconds'"),
    ],
)
def test_what_is_no_piece_is_refused(tmp_path, text, words):
    path = tmp_path / "piece.json"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_piece(path)


def test_a_slow_method_leaves_out_the_cases_of_many_steps():
    (batch,), _ = batches([case_named(n) for n in ("plain_knee", "step_of_50_us", "bounce_to_rest")], "P5")
    assert short_enough(batch, method_named("ali3p")) == [0, 2]
    assert short_enough(batch, method_named("linear_implicit")) == [0, 1, 2]


@pytest.mark.slow
def test_what_is_missing_is_run_and_what_is_there_is_not(tmp_path, monkeypatch):
    """A run that breaks off keeps what it has, and the next one goes on from there."""
    ran: list[tuple[str, str]] = []
    breaks = [("P2", "newmark")]

    def cells_of(prepared, method, say):
        if (prepared.contact, method.name) in breaks:
            breaks.clear()
            raise KeyboardInterrupt
        ran.append((prepared.contact, method.name))
        return [Cell("a", prepared.contact, method.name, "float64", "pass", "")]

    monkeypatch.setattr(whole, "cells_of", cells_of)
    chosen = EVERYTHING._replace(contacts=("P2", "P5"))
    wanted = {c: [m.name for m in INTEGRATORS if m.only is None or c in m.only] for c in ("P5", "P2")}
    with pytest.raises(KeyboardInterrupt):
        whole.run_missing(tmp_path, chosen, processes=1, cache_dir="")
    assert len(list(tmp_path.glob("*.json"))) == len(ran) == 11
    before = list(ran)
    calls: list[tuple[int, int]] = []
    tell = {"progress": lambda *counts: calls.append(counts)}
    written = whole.run_missing(tmp_path, chosen, processes=1, cache_dir="", **tell)
    assert (calls[0], calls[-1]) == ((0, len(written)), (len(written), len(written)))
    assert [(c, m) for c, names in wanted.items() for m in names] == ran
    assert len(written) == len(ran) - len(before) > 0
    assert {(c.contact, c.integrator) for p in read_pieces(tmp_path) for c in p.rows} == set(ran)
    assert whole.run_missing(tmp_path, chosen, processes=1, cache_dir="") == []


def test_every_contact_has_its_place_in_the_order_of_work():
    assert sorted(whole.LONGEST_FIRST) == sorted(CONTACTS)


def test_a_part_of_the_matrix_is_not_saved_as_complete(tmp_path):
    from typer.testing import CliRunner

    from pftwin.cli.program import app

    for part in (["--case", "mass_zero"], ["--dtype", "float64"], ["--quick"], ["--from", str(tmp_path)]):
        done = CliRunner().invoke(app, ["hard-cases", "--into", str(tmp_path), *part])
        assert done.exit_code == 2
        assert "--into given with a part of the matrix" in done.output
    assert list(tmp_path.iterdir()) == []
