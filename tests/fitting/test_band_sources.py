"""By how much bands would be narrower if a source of uncertainty were known: on normal draws, by closed forms."""

from __future__ import annotations

import json
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from made_estimates import made_estimate

from fitting.estimate import Estimate
from fitting.parameters import REQUESTED
from fitting.prediction.band_sources import ALL, BandSources, band_sources
from fitting.prediction.plots import PANELS
from pftwin.base.errors import InputError

OUTCOMES = ("mean_tilt", "peak_contact_force")
SOURCES = [REQUESTED, REQUESTED, "friction", "attachments"]


def prediction(count: int, tilt: np.ndarray, force: np.ndarray, theta: np.ndarray) -> Any:
    """Of one variant; sample 0, the estimate, lies far from all draws."""
    import xarray

    first = np.full((1, theta.shape[1]), 1e3)
    return xarray.Dataset(
        {
            "mean_tilt": (("variant", "sample"), np.concatenate([[1e6], tilt])[None]),
            "peak_contact_force": (("variant", "sample"), np.concatenate([[1e6], force])[None]),
            "parameters": (("sample", "parameter"), np.concatenate([first, theta])),
        },
        {"parameter_kind": ("parameter", SOURCES), "sample": np.arange(count + 1)},
    )


def normal(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draws of four numbers of unlike size, the third and the fourth correlated by 0.8; and noise."""
    random = np.random.default_rng(5)
    z = random.standard_normal((count, 5))
    z[:, 3] = 0.8 * z[:, 2] + 0.6 * z[:, 3]
    return z[:, :4] * [2.0, 3.0, 1e-3, 5.0] + [150.0, 0.0, 0.02, 7.0], z[:, 4]


def test_what_is_left_is_the_conditional_variance():
    """Tilt = 2 z1 + z2 (z of unit variance): known springs leave none. Force = 3 z1 + 4 z4: known springs leave 4/5 of
    the width, z4 leaves 3/5, and z3, which tells 0.64 of the variance of z4, sqrt((9 + 16 0.36) / 25)."""
    theta, _ = normal(4000)
    tilt = theta[:, 0] + theta[:, 1] / 3
    force = 1.5 * theta[:, 0] + 0.8 * theta[:, 3]
    found = band_sources(prediction(4000, tilt, force, theta), OUTCOMES)
    assert found.sources == (REQUESTED, "friction", "attachments", ALL)
    expected = [[1, 0.2], [0, 1 - np.sqrt(14.76) / 5], [0, 0.4], [1, 1]]
    np.testing.assert_allclose(found.narrower, expected, atol=0.02)


def test_what_is_bent_is_of_no_source():
    """Tilt = z1 + (z2^2 - 1) / sqrt(2): all together leave half of the variance."""
    theta, _ = normal(4000)
    bent = theta[:, 0] / 2 + ((theta[:, 1] / 3) ** 2 - 1) / np.sqrt(2)
    found = band_sources(prediction(4000, bent, bent, theta), ("mean_tilt",))
    assert found.narrower[-1, 0] == pytest.approx(1 - np.sqrt(0.5), abs=0.03)


def test_noise_of_few_draws_is_not_taken_for_a_source():
    """Of fifteen draws in the mean over many: nothing; of fewer than four for a number: no figure."""
    rows = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        theta, y = random.standard_normal((15, 4)), random.standard_normal(15)
        rows.append(band_sources(prediction(15, y, y, theta), ("mean_tilt",)).narrower[:, 0])
    mean = np.mean(rows, axis=0)
    assert (np.abs(mean[:3]) < 0.06).all()
    assert np.isnan(mean[3])


def test_words_and_figures_say_the_same(tmp_path):
    theta, noise = normal(400)
    found = band_sources(prediction(400, theta[:, 0] + 0 * noise, noise, theta), OUTCOMES)
    sheet = found.sheet()
    assert sheet.headings == ("if it were known", "mean tilt", "peak contact force")
    assert sheet.rows[0][:2] == (REQUESTED, "100")
    assert found.facts()[REQUESTED]["mean_tilt"] == pytest.approx(1.0)
    bars = [patch.get_width() for patch in found.figure().axes[0].patches]
    np.testing.assert_allclose(bars, 100 * found.narrower[:, 0])


def test_the_figures_texts_do_not_overlap():
    note = "95 % bands hold the uncertainty of the fitted parameters alone, and nothing of the model's own error."
    sources = (REQUESTED, "damping", "attachments", "friction", ALL)
    narrower = np.linspace(0, 1, 20).reshape(5, 4)
    figure = BandSources(sources, tuple(name for name, _, _ in PANELS), narrower, "case 2 of the rig", note).figure()
    figure.draw_without_rendering()
    texts = [t for ax in figure.axes for t in (ax.title, ax.xaxis.label, *ax.get_xticklabels())]
    boxes = [t.get_window_extent() for t in [*texts, *figure.texts] if t.get_text()]
    assert len(boxes) > 12
    assert not [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_draws_that_failed_are_left_out():
    theta, noise = normal(400)
    tilt = theta[:, 0] + noise
    tilt[7:20] = np.nan
    kept = np.delete(np.arange(400), np.s_[7:20])
    found = band_sources(prediction(400, tilt, tilt, theta), OUTCOMES)
    other = band_sources(prediction(387, tilt[kept], tilt[kept], theta[kept]), OUTCOMES)
    np.testing.assert_allclose(found.narrower, other.narrower)


def test_without_draws_or_sources_there_are_none():
    theta, noise = normal(40)
    data = prediction(40, noise, noise, theta)
    with pytest.raises(InputError, match="a prediction without draws of known sources"):
        band_sources(data.drop_vars("parameter_kind"))
    with pytest.raises(InputError, match="samples=200"):
        band_sources(data.isel(sample=0))


def test_an_older_file_tells_no_sources(tmp_path):
    path = made_estimate({"K1": (150.0, 2.0), "L1": (0.14, 0.001)}).save(tmp_path / "fit.json")
    content = json.loads(path.read_text())
    del content["kinds"]
    path.write_text(json.dumps(content))
    assert Estimate.load(path).kinds == ()
