"""`PredictedMotion`: a predicted motion with bands, compared with measurements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pftwin.base.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import Dataset

LEVEL = 0.9  # nominal coverage of bands
COORDINATES = {  # unit, meaning
    "x": ("mm", "centre, proximal"),
    "y": ("mm", "centre, lateral"),
    "z": ("mm", "centre, anterior"),
    "flexion": ("deg", "patellar flexion"),
    "rotation": ("deg", "rotation, internal positive"),
    "tilt": ("deg", "tilt, lateral positive"),
}


@dataclass(frozen=True, eq=False)
class PredictedMotion:
    """Predicted motion over n frames, as the six `COORDINATES` in their units.

    times: (n,) [s].
    value, low, high: (n, 6) the estimate's own motion, and the band's ends.
    measured: (n, 6), NaN where not measured; None if nothing was.
    compared: (n,) whether the frame is compared with the measurements.
    verdict: on the estimate's motion, "valid" or "INVALID: ...".
    notes: qualify the bands.
    objection: why the estimate must not be used; empty if there is no reason.
    label: of the measurements in figures.
    """

    scene_name: str
    times: Floats
    value: Floats
    low: Floats
    high: Floats
    measured: Floats | None
    compared: NDArray[np.bool_]
    verdict: str
    notes: tuple[str, ...]
    objection: str = ""
    label: str = "measured"

    @property
    def _caveats(self) -> tuple[str, ...]:
        return (self.objection, *self.notes) if self.objection else self.notes

    @property
    def errors(self) -> dict[str, float]:
        """RMS error of each coordinate and mean distance, over the compared frames; empty if there are none."""
        if self.measured is None or not self.compared.any():
            return {}
        off = (self.value - self.measured)[self.compared]
        distance = np.linalg.norm(off[:, :3], axis=1)
        found = {"mean_distance": float(np.nanmean(distance))} if np.isfinite(distance).any() else {}
        there = {name: own for name, own in zip(COORDINATES, off.T, strict=True) if np.isfinite(own).any()}
        return found | {name: float(np.sqrt(np.nanmean(own**2))) for name, own in there.items()}

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the compared frames whose measurement lies within the band, by coordinate."""
        if self.measured is None:
            return {}
        measured, low, high = (a[self.compared] for a in (self.measured, self.low, self.high))
        inside, there = (measured >= low) & (measured <= high), np.isfinite(measured)
        return {n: float(inside[there[:, k], k].mean()) for k, n in enumerate(COORDINATES) if there[:, k].any()}

    @property
    def mean_coverage(self) -> float | None:
        """Mean of `coverage` over the coordinates; None if nothing was compared."""
        return float(np.mean(list(self.coverage.values()))) if self.coverage else None

    def sentence(self) -> str:
        """The result in a sentence."""
        if self.verdict != "valid":
            return self.verdict
        if not self.errors:
            return f"{self.scene_name}: {self.times.size} frames predicted; nothing was measured there"
        e, covered, count = self.errors, self.mean_coverage or 0.0, int(self.compared.sum())
        path = f"{e['mean_distance']:.2g} mm from the measured path on average" if "mean_distance" in e else "turns"
        angles = "".join(f", {name} {e[name]:.2g} deg rms" for name in ("rotation", "flexion", "tilt") if name in e)
        return (
            f"{self.scene_name}: {path} of {count} frames"
            f"{angles}; {100 * LEVEL:.0f} % bands contain {100 * covered:.0f} % of the measurements"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        facts = {"scene": self.scene_name, "verdict": self.verdict, "level": LEVEL, "notes": list(self._caveats)}
        return {**facts, "errors": self.errors, "coverage": self.coverage, "sentence": self.sentence()}

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Coordinate, unit, RMS error, share of frames whose measurement lies within the band."""
        return [
            (meaning, unit, f"{self.errors[name]:.2f}", f"{100 * self.coverage[name]:.0f} %")
            for name, (unit, meaning) in COORDINATES.items()
            if name in self.errors
        ]

    def dataset(self) -> Dataset:
        """All values as a dataset over time and coordinate."""
        from xarray import Dataset

        axes = ("time", "coordinate")
        given = {"value": self.value, "low": self.low, "high": self.high}
        given |= {} if self.measured is None else {"measured": self.measured}
        words = {"value": "of the estimate", "low": "band, lower end", "high": "band, upper end"}
        variables = {name: (axes, a, {"long_name": words.get(name, name)}) for name, a in given.items()}
        coordinates = {
            "time": (("time",), self.times, {"units": "s", "long_name": "time"}),
            "coordinate": (("coordinate",), list(COORDINATES), {"long_name": "of the patella in the femur"}),
            "unit": (("coordinate",), [unit for unit, _ in COORDINATES.values()], {"long_name": "its unit"}),
            "compared": (
                ("time",),
                self.compared,
                {"long_name": "whether compared with the measurements", "units": "1"},
            ),
        }
        about = {"title": f"predicted motion: {self.scene_name}", "level": LEVEL, "verdict": self.verdict}
        return Dataset(variables, coordinates, {**about, "note": "; ".join(self._caveats)})

    def figure(self) -> Figure:
        """Six panels over time: band, the estimate's motion and the measurements; frames that are not compared have
        a grey background."""
        from pftwin.results.plots import style

        with style.house_style():
            figure, panels = style.panels_in_rows(len(COORDINATES), 3, height=2.1)
            style.title(figure, f"{self.scene_name}, predicted, with bands of {100 * LEVEL:.0f} %")
            style.footer(figure, "; ".join(self._caveats))
            look = style.line(0)
            for k, (ax, (unit, meaning)) in enumerate(zip(panels, COORDINATES.values(), strict=True)):
                ends = self.low[:, k], self.high[:, k]
                ax.fill_between(self.times, *ends, alpha=0.25, color=look["color"], linewidth=0, label="band")
                if self.measured is not None:
                    ax.plot(self.times, self.measured[:, k], label=self.label, **style.MEASURED)
                ax.plot(self.times, self.value[:, k], label="predicted", zorder=2, **look)
                for first, last in self._not_compared():
                    ax.axvspan(first, last, color="black", alpha=0.08, linewidth=0)
                ax.set(xlabel="time [s]", ylabel=f"{meaning} [{unit}]")
                ax.yaxis.label.set_fontsize(style.SMALL)
            style.legend_below(figure, *panels[0].get_legend_handles_labels(), most=4)
        return figure

    def _not_compared(self) -> list[tuple[float, float]]:
        """Spans of time that are not compared, if other frames are."""
        if not self.compared.any():
            return []
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (~self.compared).astype(int), [0]])))
        return [(float(self.times[a]), float(self.times[b - 1])) for a, b in edges.reshape(-1, 2)]
