"""`pftwin report`: what it writes, says, and refuses."""

from __future__ import annotations

import json

import pytest
from report_pages import VALUES, Seen, estimate, prediction
from small_scene import small_result
from typer.testing import CliRunner

from pftwin.cli import app
from pftwin.files.result_files import save_dataset
from pftwin.rig.recording import source_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("files")
    small_result().save(path / "knee.nc")
    save_dataset(prediction(), path / "variants.nc")
    estimate().save(path / "fit.json")
    estimate(scene_name="rig case 2, P5", source=source_of(2)).save(path / "rig.json")
    estimate(scene_name="rig case 2, P5").save(path / "namesake.json")
    (path / "other.json").write_text("{}", encoding="utf-8")
    (path / "notes.txt").write_text("none", encoding="utf-8")
    (path / "empty").mkdir()
    return path


def run(*arguments: object):
    return CliRunner().invoke(app, ["report", *map(str, arguments)], env={"COLUMNS": "160", "NO_COLOR": "1"})


@pytest.mark.slow
def test_writes_a_page_of_a_result(folder, tmp_path):
    page = tmp_path / "report.html"
    done = run(folder / "knee.nc", "--treatment", folder / "variants.nc", "-o", page, "--json", "-")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["bytes"] == page.stat().st_size < 12e6
    assert said["synthetic"] == []
    seen = Seen(page.read_text(encoding="utf-8"))
    assert "Without dislocation from 10 mm of transfer medialisation on." in seen.text
    assert f"{(folder / 'knee.nc').stat().st_size:,}" in seen.text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent.nc", "-o", "r.html"), "no such file"),
        (("notes.txt", "-o", "r.html"), "not a file that a report can be made from"),
        (("other.json", "-o", "r.html"), "no estimate"),
        (("empty", "-o", "r.html"), "there is no fit.json in this folder"),
        (("variants.nc", "-o", "r.html"), "pftwin report fit.json --treatment variants.nc"),
        (("knee.nc", "--treatment", "knee.nc", "-o", "r.html"), "no prediction of treatments in it"),
        (("knee.nc", "--contact", "P4", "-o", "r.html"), "--contact without a scene"),
        (("knee.nc", "-o", "report.pdf"), "the page is HTML; try: report.html"),
        (("knee.nc", "-o", "absent/report.html"), "there is no folder absent"),
        (("fit.json", "-o", "r.html"), "--scene knee/scene.toml or --case N"),
        (("namesake.json", "-o", "r.html"), "--scene knee/scene.toml or --case N"),
        (
            ("knee.nc", "--case", "2", "-o", "r.html"),
            "belongs to the scene 'small knee', but the given scene is 'rig",
        ),
    ],
)
def test_mistakes_are_named(folder, monkeypatch, arguments, words):
    monkeypatch.chdir(folder)
    done = run(*arguments)
    assert done.exit_code == 2, done.output
    assert words in done.stderr
    assert "Traceback" not in done.output
    assert not list(folder.glob("*.html"))


@pytest.mark.slow
def test_a_fit_of_the_rig_finds_its_scene(folder, tmp_path):
    page = tmp_path / "report.html"
    done = run(folder / "rig.json", "-o", page)
    assert done.exit_code == 0, done.output
    seen = Seen(page.read_text(encoding="utf-8"))
    assert "Synthetic data:" in seen.text
    assert set(VALUES) <= set(seen.rows)
    assert seen.rows["position of the button's centre"] == [["721", "0", "0"]]


@pytest.mark.slow
def test_the_demos_folder(folder, tmp_path):
    """Its fits, its runs, its table and its pictures; nothing is simulated."""
    demo = tmp_path / "demo"
    demo.mkdir()
    for name in ("fit.json", "fit_force.json"):
        estimate(scene_name="rig case 2, P5", source=source_of(2), synthetic=True).save(demo / name)
    for n in (1, 2):
        small_result().save(demo / f"case{n}_P5.nc")
    lines = [
        "row,unit,case2_by_paper,case2_published,case1_by_paper,case1_published",
        "tilt RMSE,deg,7.17987,3.63,2.08,",
    ]
    (demo / "table2.csv").write_text("\n".join(lines), encoding="utf-8")
    done = run(demo, "-o", tmp_path / "report.html")
    assert done.exit_code == 0, done.output
    seen = Seen((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert seen.rows["tilt RMSE"] == [["deg", "7.18", "3.63", "2.08", "–"]]
    assert seen.rows["case 1, treatment"] == [[small_result().dislocations().describe()]]
    assert "Synthetic data: the motion is synthetic" in seen.text
    assert "By the paper's objective" in seen.text
    (demo / "treatment_predicted.png").write_bytes(b"<svg onload=alert(1)>")
    refused = run(demo, "-o", tmp_path / "again.html")
    assert refused.exit_code == 2
    assert "is no PNG picture" in refused.stderr
