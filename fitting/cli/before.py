"""`pftwin plan-experiment` and `pftwin train-posterior`: what is done before a recording is fitted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from fitting.cli.fit_options import ExperimentOptions, FitOptions
from pftwin.base.sheet import Sheet
from pftwin.cli.scenes import on_scene
from pftwin.cli.terminal import JsonOption, check_outputs, check_suffix, present, progress, spinner, written_line


@on_scene
def plan_experiment(
    *,
    knee: ExperimentOptions,
    json: JsonOption = None,
) -> None:
    """Say how precisely an experiment could determine the parameters, before it is made, and what else to measure.

    Of several scenes the first is recorded, and the others might be, as further trials of the same knee.

    Example: `pftwin plan-experiment --case 2 --use position --noise position=2e-4`, or
    `pftwin plan-experiment walk.toml stairs.toml`
    """
    check_outputs(json)
    asked = knee.asked()
    chosen, *further = knee.load()
    from fitting.identifiability import plan_experiment as plan
    from fitting.programs import channels_of

    if asked["use"] == "all":
        asked["use"] = channels_of(chosen.scene)
    with spinner("linearising the motion"):
        found = plan(chosen.scene, **asked, further=[each.scene for each in further])
    deviations = {", ".join(found.channels): found.relative, **{f"and {c}": v for c, v in found.additions.items()}}
    sheet = Sheet(
        f"{chosen.scene.name}: smallest possible standard deviations [%]",
        ("measured", *found.names),
        tuple((words, *(f"{100 * v:.3g}" for v in values)) for words, values in deviations.items()),
        words=(0,),
    )
    present({"scene": chosen.scene.name, **found.to_dict()}, sheet, found.sentence(), json=json)


@on_scene
def train_posterior(
    *,
    output: Annotated[Path, Option("-o", "--output", metavar="FILE.npz", help="The trained posterior.")],
    knee: FitOptions,
    simulations: Annotated[int | None, Option(min=1000, help="To learn from; 30,000 if left out.")] = None,
    seed: Annotated[int, Option(min=0, help="Of all random choices.")] = 0,
    json: JsonOption = None,
) -> None:
    """Train a posterior once for a set-up, which then answers each of its recordings in seconds.

    Example: `pftwin train-posterior knee.toml --nuisance mri -o knee.npz`, then
    `pftwin fit walk2.toml --trained knee.npz -o fit.json`
    """
    check_suffix(output, [".npz"], "trained posteriors are files of NumPy's")
    check_outputs(output, json)
    asked, limits, scenes = knee.asked(), knee.limits(), [trial.scene for trial in knee.load()]
    from fitting.training import train_posterior as train

    with progress("compiling") as shown:
        found = train(
            scenes,
            **asked,
            seed=seed,
            simulations=simulations,
            limits=limits,
            progress=lambda done, of: shown(done, of, what="simulations" if done < of else "networks"),
        )
    files = [str(found.save(output))]
    rows = tuple((name, f"{low:.6g} to {high:.6g}") for name, (low, high) in found.set_up.bounds.items())
    sheet = Sheet(f"{found.set_up.scene_name}: posterior by {found.simulations} simulations", ("", "bounds"), rows)
    present({**found.facts(), "files": files}, sheet, found.sentence(), written_line(files), json=json)
