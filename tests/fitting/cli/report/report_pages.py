"""What reports are made of in these tests, and what is on their pages."""

from __future__ import annotations

import dataclasses
from html.parser import HTMLParser
from pathlib import Path
from unittest import mock

import numpy as np
from made_estimates import made_estimate
from small_scene import small_result, small_scene

from fitting.cli.report import figures
from fitting.cli.report.command import report_page
from fitting.cli.report.material import Material
from fitting.cli.report.run import ReportedRun
from fitting.estimate import Estimate
from pftwin.base.errors import InputError
from pftwin.model.measured import Measured

VALUES = {"K1": (171.0, 12.5), "L1": (0.1512, 0.002), "K2": (601.0, 31.0), "L2": (0.0733, 0.0011)}


class Seen(HTMLParser):
    """Tags with their attributes, the text outside the style sheet, and the rows of all tables."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.text, self.rows = "", {}
        self._row: list[str] = []
        self._silent = False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, {k: v or "" for k, v in attrs}))
        self._silent = tag == "style"
        if tag == "tr":
            self._row = []
        if tag in ("td", "th"):
            self._row.append("")

    def handle_endtag(self, tag):
        self._silent = False
        if tag == "tr" and self._row:
            self.rows.setdefault(self._row[0], []).append(self._row[1:])

    def handle_data(self, data):
        if not self._silent:
            self.text += data
            if self._row:
                self._row[-1] += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.tags if name == tag]


def words_of(material: Material, command: str = "") -> Seen:
    """A report whose pictures and viewer, which take most of the time, are left out."""
    no_viewer = mock.patch.object(figures, "viewer", side_effect=InputError("left out"))
    with no_viewer, mock.patch.object(figures.Picture, "source", "data:image/png;base64,"):
        return Seen(report_page(material, command)[0])


def estimate(values=VALUES, **more) -> Estimate:
    """Of the small knee."""
    about = {
        "synthetic": False,
        "source": "the laboratory",
        "scene_name": "small knee",
        "rmse": {"position": 0.00123},
        "noise": {"position": 0.0011},
        "serial_correlation": 0.25,
        "starts": 8,
        "seed": 7,
    }
    return made_estimate(values, **{**about, **more})


def measured() -> Measured:
    """The small knee's own motion, with frames 5 to 8 and frame 20 missing."""
    result = small_result()
    center = result.center.copy()
    center[[5, 6, 7, 8, 20]] = np.nan
    return Measured(result.times, center, source="the laboratory")


def fitted(folder: Path, **more) -> Material:
    """A fit of the small knee with a run, as `gathered` would leave it."""
    path = folder / "fit.json"
    found = estimate(**more)
    found.save(path)
    knee = dataclasses.replace(small_scene(), measured=measured())
    found = found.about(knee)
    runs = [ReportedRun.of_result(small_result(), "fitted")]
    return Material(path, "Fitted knee: small knee", {"the fit": found}, knee, runs, files=[path])


def prediction(**attributes):
    """Three amounts of a treatment, each with the estimate and four draws; the first dislocates."""
    from xarray import Dataset

    base = np.arange(15.0).reshape(3, 5)
    axes = ("variant", "sample")
    out = np.zeros((3, 5))
    out[0] = 1.0
    units = {
        "largest_offset": ("m", 0.02 - 0.001 * base),
        "largest_lateral_offset": ("m", np.where(base < 10, 0.02 - 0.001 * base, 0.004)),  # the last strays medially
        "mean_tilt": ("deg", base - 5),
        "mean_shift": ("m", 1e-4 * base),
        "peak_contact_force": ("N", 20.25 + base),
        "medial_share": ("1", 0.2 + 0.01 * base),
        "dislocations": ("1", out),
        "dislocation_side": ("1", out),
        "dislocation_flexion": ("deg", np.where(out > 0, 12.0, np.nan)),
        "re_engagement_flexion": ("deg", np.full((3, 5), np.nan)),
        "failed": ("1", np.zeros((3, 5), dtype=bool)),
    }
    amounts = np.array([0.0, 0.01, 0.02])
    about = {"title": "predicted outcomes: small knee", "parameters": "estimated", "threshold": 0.02, **attributes}
    return Dataset(
        {
            **{n: (axes, v, {"units": u}) for n, (u, v) in units.items()},
            "parameters": (("sample", "parameter"), np.tile([v for v, _ in VALUES.values()], (5, 1))),
        },
        {
            "scene": (("variant",), ["small knee"] * 3),
            "treatment": (("variant",), ["a", "b", "c"]),
            "transfer_medialisation": (("variant",), amounts, {"units": "m"}),
            "parameter": (("parameter",), list(VALUES)),
        },
        about,
    )
