"""The examples of docs/interchange.md run as they are printed, one after the other."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from small_scene import small_result

from pftwin.base.errors import PftwinWarning
from pftwin.files.interchange.exporting import FORMATS
from pftwin.files.interchange.osim_joints import JOINTS, KINDS

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "interchange.md").read_text(encoding="utf-8")


def test_the_examples_run(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install pandas")
    monkeypatch.chdir(tmp_path)
    result = small_result()
    result.save("case2.nc")
    result.to_csv("case2.csv")
    names: dict = {"__name__": "page"}
    examples = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert len(examples) == 4
    for example in examples:
        exec(compile(example, "interchange.md", "exec", dont_inherit=True), names)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case2.csv", "case2.glb", "case2.mot", "case2.nc"]
    assert "deg" in capsys.readouterr().out
    assert len(names["table"]) == len(names["same"]) == result.times.size
    np.testing.assert_allclose(names["same"]["patella_tilt [deg]"], names["table"]["patella_tilt"], atol=1e-9)


def test_the_reader_that_the_page_recommends_gives_the_coordinates_back(tmp_path):
    from pftwin.files.interchange import export
    from pftwin.files.interchange.exporting import coordinates
    from pftwin.files.mocap import read_sto

    result = small_result()
    export(result, tmp_path / "case2.mot")
    (patterns,) = re.findall(r"rotational=(\[.*?\])", PAGE)
    written = coordinates(result.to_dataset())
    in_si = [values if name[-4:-2] in ("tx", "ty", "tz") else np.radians(values) for name, values in written.items()]
    read = read_sto(tmp_path / "case2.mot", rotational=eval(patterns))
    assert read.names == tuple(written)
    np.testing.assert_allclose(read.values.T, in_si, atol=1e-10)
    with pytest.warns(PftwinWarning, match="converted to radians"):
        read = read_sto(tmp_path / "case2.mot")
    np.testing.assert_allclose(read.values.T, in_si, atol=1e-10)


def test_the_page_names_what_there_is():
    assert all(f"`{suffix}`" in PAGE for suffix in FORMATS)
    assert all(f"`{kind}`" in PAGE for kind in KINDS)
    assert all(f"`{kind.removesuffix('Joint')}`" in PAGE for kind in JOINTS)
