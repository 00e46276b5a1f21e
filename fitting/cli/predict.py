"""`pftwin predict`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from fitting.cli.fit_options import DuringOption, time_spans, units_of, within
from fitting.cli.treat import SeedOption, StepOption
from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import numbers_by_name
from pftwin.cli import terminal
from pftwin.cli.exit_codes import exit_flagged
from pftwin.cli.scenes import RecordingOptions, on_scene

if TYPE_CHECKING:
    from pftwin.model.scene import Scene


@on_scene
def predict(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="OUT.nc", help="NetCDF file for the motion and bands.")],
    estimate: Annotated[Path, Option(metavar="FIT.json", help="Estimate from `pftwin fit`.")],
    knee: RecordingOptions,
    given: Annotated[
        list[str] | None,
        Option(
            "--set",
            metavar="NAME=VALUE",
            help="Value of a scene parameter here, or its range LOW:HIGH (in SI, or with a unit); may be repeated.",
        ),
    ] = None,
    during: DuringOption = None,
    samples: Annotated[int, Option(min=1, help="Draws from the estimate, for bands.")] = 50,
    seed: SeedOption = 0,
    dt: StepOption = None,
    figure: Annotated[bool, Option(help="Also write figures OUT.png and OUT.svg.")] = True,
    json: terminal.JsonOption = None,
) -> None:
    """Predict a fitted knee's motion in the same or another recording, with bands for its measurements.

    Example: `pftwin predict knee/scene.toml --estimate fit.json --motion other.sto --rate 30 -o other.nc`
    """
    terminal.check_suffix(output, [".nc"], "results are NetCDF")
    pictures = [output.with_suffix(s) for s in (".png", ".svg")] if figure else []
    terminal.check_outputs(output, *pictures, json)
    spans = time_spans(during)
    terminal.start_computing(batches=True)
    from fitting.estimate import Estimate

    found = Estimate.load(estimate)
    scene = within(knee.load().scene, spans)
    values = _values(given, scene)
    if spans and scene.measured is None:
        raise InputError("nothing to compare with", where="--during", expected="a recording of the patella")
    from fitting.prediction.motion import predict_motion
    from fitting.prediction.predicted_motion import LEVEL
    from pftwin.files.result_files import save_dataset
    from pftwin.results.plots import save_figure

    with terminal.progress("compiling and simulating") as shown:

        def report(done: int, of: int) -> None:
            shown(done, of, f"{done} of {of} motions")

        motion = predict_motion(scene, found, samples=samples, seed=seed, values=values, dt=dt, progress=report)
    with terminal.spinner("writing"):
        save_dataset(motion.dataset(), output)
        files = [output, *(save_figure(motion.figure(), output.with_suffix("")) if figure else [])]
    head = ("", "unit", "rms error", f"in bands of {100 * LEVEL:.0f} %")
    sheets = [Sheet(motion.scene_name, head, tuple(motion.rows()), words=(0, 1))] if motion.errors else []
    facts = {**motion.to_dict(), "files": [str(path) for path in files]}
    invalid = "" if motion.verdict == "valid" else motion.verdict
    first, sentence = (invalid, motion.objection), "" if invalid else motion.sentence()
    terminal.present(facts, *first, *sheets, sentence, *motion.notes, terminal.written_line(files), json=json)
    if why := invalid or motion.objection:
        exit_flagged(why)


def _values(given: list[str] | None, scene: Scene) -> dict[str, float | tuple[float, float]]:
    """Parses "name=value" and "name=low:high", with or without units, into values and ranges [SI] by parameter."""
    expected = 'such as "quadriceps.tension[:]=40 N", or "=20:60"'
    found = numbers_by_name(given, "--set", expected, (1, 2), units_of(scene))
    return {name: own[0] if len(own) == 1 else (own[0], own[1]) for name, own in found.items()}
