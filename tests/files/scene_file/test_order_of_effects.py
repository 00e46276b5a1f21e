"""Effects stand in a scene in the order of the tables in its file, by which K1, L1, K2, ... are numbered."""

from __future__ import annotations

from pathlib import Path

import pytest
from toy_scene_files import changed, load

import pftwin
from pftwin.files.scene_file import registry
from pftwin.model.effects.tendon import ToeTendon

QUADRICEPS = '[[tendon]]\nname = "quadriceps"\n'
DAMPING = "damping_time_s = 0.01\n"


class Aponeurosis(ToeTendon):
    """A registered effect: a tendon whose table follows from its declarations."""


def quadriceps_of(kind: str, more: str) -> str:
    """The toy scene with the quadriceps as a table of this kind, which stands before that of the patellar tendon."""
    return changed(DAMPING, more, changed(QUADRICEPS, QUADRICEPS.replace("tendon", kind, 1)))


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("toe_tendon", DAMPING),
        ("viscoelastic_tendon", "maxwell_stiffness_N_per_m = 30\nrelaxation_time_s = 0.5\n"),
        ("aponeurosis", "damping_N_s_per_m = 1.56\ntoe_strain = 0.05\n"),
    ],
)
def test_the_first_line_of_the_file_is_number_one(
    toy: Path, monkeypatch: pytest.MonkeyPatch, kind: str, more: str
) -> None:
    monkeypatch.setattr(registry, "_registered", {})  # registered for this test only
    pftwin.register_effect(Aponeurosis)
    scene = load(toy, quadriceps_of(kind, more))
    assert [e.name for e in scene.effects] == ["gravity", "quadriceps", "patellar_tendon", "contact"]
    numbers = [float(scene.get(name)) for name in ("K1", "L1", "K2", "L2")]
    assert numbers == pytest.approx([156, 0.1432, 629, 0.0714])  # as written in the file


def test_tables_of_one_kind_stand_together_where_the_first_of_them_stands(toy: Path) -> None:
    text = quadriceps_of("toe_tendon", DAMPING)
    graft = text[text.index("[[toe_tendon]]") : text.index("[[tendon]]")].replace("quadriceps", "graft")
    assert [e.name for e in load(toy, text + graft).effects] == [
        "gravity",
        "quadriceps",
        "graft",
        "patellar_tendon",
        "contact",
    ]
