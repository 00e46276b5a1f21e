"""Models that are wrong, or mean harm: refused with their line, and nothing is written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from at_once import at_once
from knee_models import PATELLA, PT, TIBIA, ligament, ligaments, model, write_knee

from pftwin.base.errors import InputError
from pftwin.files.interchange import import_osim
from pftwin.files.interchange.osim_document import read_osim


def bare(folder: Path, text: str, **options):
    """A model without meshes."""
    folder.mkdir(exist_ok=True)
    (folder / "bare.osim").write_text(text)
    return import_osim(folder / "bare.osim", folder / "out", **options)


def test_meshes_are_searched_beside_the_model_only(tmp_path):
    """A path in a stranger's file leads nowhere."""
    secret = tmp_path / "secret"
    write_knee(secret)
    text = model().replace(">femur.stl<", f">{secret}/femur.stl<")
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "knee.osim").write_text(text)
    report = import_osim(folder / "knee.osim", tmp_path / "scene")
    why = {part.name: part.why for part in report.left_out}
    assert "no mesh 'femur.stl'" in why["pf_contact"]
    assert "no mesh 'femur.stl'" in why["femur_r_bone"]
    assert any("needs a [contact] of your own" in note for note in report.notes)
    assert import_osim(folder / "knee.osim", tmp_path / "other", geometry=[secret]).left_out != report.left_out


def test_names_cannot_write_into_the_scene(tmp_path):
    evil = 'a"\n[gravity]\nx = 1 \x7f é'
    shown = evil.replace('"', "&quot;").replace("\n", "&#10;").replace("\x7f", "&#127;")
    text = model(forces=ligament(shown, (PATELLA, PT[0]), (TIBIA, PT[1]), k=1, slack=0.1), meshes=False)
    report = bare(tmp_path, text.replace('name="small_knee"', f'name="{shown}"'))
    import tomllib

    data = tomllib.loads(report.scene.read_text())
    assert data["name"] == 'a" [gravity] x = 1   é'
    assert set(data["gravity"]) == {"acceleration_m_per_s2"}
    assert data["strands"][0]["name"].isidentifier()


BOMB = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>\n'
OUTSIDE = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]>\n'


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace("<OpenSim", BOMB + "<OpenSim", 1), r"line 2: it declares a DOCTYPE"),
        (lambda t: t.replace("<OpenSim", OUTSIDE + "<OpenSim", 1), r"line 2: it declares a DOCTYPE"),
        (lambda t: t.replace("</Model>", "<a>" * 100 + "</a>" * 100 + "</Model>"), "nested deeper than 64"),
        (lambda t: t.replace("</Model>", "<a/>" * 250_000 + "</Model>"), "more than 200,000 elements"),
        (lambda t: t[:-40], "no valid XML"),
        (lambda t: t.replace("UTF-8", "UTF-1e999"), "no readable XML: unknown encoding: UTF-1e999; expected: UTF-8"),
        (lambda t: t.replace("UTF-8", "shift_jis"), "no readable XML: multi-byte encodings are not supported"),
        (lambda t: t.replace(">-1 0<", ">1e308 0<", 1), "the pose of 'tibia_r' is not finite; expected: functions"),
        (lambda t: t.replace("OpenSimDocument", "Scene"), "the document is a <Scene>"),
        (lambda t: t.replace('Version="40000"', 'Version="30000"'), "open the model in OpenSim 4 and save it"),
        (
            lambda t: t.replace('Version="40000"', f'Version="{"4" * 5000}"'),
            "version 44444444444444444444; expected: ",
        ),
        (lambda t: t.replace('Version="40000"', 'Version="4²"'), "version 4²; expected: "),
        (
            lambda t: t.replace("<mass>0.12</mass>", "<mass>heavy</mass>"),
            r"line 5: <mass> is 'heavy'; expected: 1 finite",
        ),
        (lambda t: t.replace("<mass>0.12</mass>", "<mass>0</mass>"), "a patella without mass"),
        (lambda t: t.replace("<location>", "<location>nan "), "expected: 3 finite numbers"),
        (
            lambda t: t.replace("/bodyset/patella_r</socket_child", "/bodyset/knee_cap</socket_child"),
            "no body and no frame",
        ),
        (lambda t: t.replace("patella_r", "kneecap"), "no body is called patella"),
        (lambda t: t.replace("<slack_length>0.06<", "<slack_length>-1<"), "slack length -1 m"),
        (
            lambda t: t.replace('<CustomJoint name="knee_r">', '<ScrewJoint name="knee_r">').replace(
                '</CustomJoint><CustomJoint name="pf_r">', '</ScrewJoint><CustomJoint name="pf_r">'
            ),
            "ScrewJoint",
        ),
        (
            lambda t: t.replace("<LinearFunction", "<SineFunction", 1).replace("</LinearFunction", "</SineFunction", 1),
            "no function <SineFunction> is known",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_line(tmp_path, change, words):
    text = change(model(forces=ligaments(), meshes=False))
    with pytest.raises(InputError, match=re.escape(words) if "line" not in words else words):
        bare(tmp_path, text)
    assert not (tmp_path / "out").exists()


def test_text_that_elements_interrupt_is_joined_once(tmp_path):
    """Each piece added to what was there before took the product of their number and the text's length."""
    long, pieces = "x" * 4_000_000, 60_000
    text = model(forces=ligaments(), meshes=False).replace("</Model>", long + "<a/>x" * pieces + "</Model>")
    (tmp_path / "bare.osim").write_text(text)
    with at_once():
        found = read_osim(tmp_path / "bare.osim")
    assert found.text.count("x") == len(long) + pieces


def test_options_are_checked(tmp_path):
    text = model(forces=ligaments(), meshes=False)
    for options, words in (
        ({"side": "up"}, "right or left"),
        ({"patella": "cap"}, "no body is called 'cap'"),
        ({"bend": "elbow"}, "no coordinate 'elbow'"),
        ({"bend": "knee_flex_r", "motion": tmp_path / "walk.mot"}, "bend given, and a motion"),
        ({"activation": 0.0, "motion": tmp_path / "walk.trc"}, "an activation, and a recording of markers"),
    ):
        with pytest.raises(InputError, match=words):
            bare(tmp_path, text, **options)
