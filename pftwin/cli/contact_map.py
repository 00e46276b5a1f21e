"""`pftwin contact-map`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from pftwin import __version__
from pftwin.base.errors import InputError
from pftwin.base.written_amounts import Direction, amount, axis_named, listed
from pftwin.cli import terminal
from pftwin.cli.exchange import RateOption
from pftwin.cli.exit_codes import Interrupted, exit_flagged, report_written_on_interrupt
from pftwin.cli.plugins import with_former_names

if TYPE_CHECKING:
    from pftwin.files.mocap.poses import PoseSeries
    from pftwin.model.effects.foundation_law import FoundationLaw
    from pftwin.studies.contact_map.mapping import ContactMap


@with_former_names({"thickness": "--thickness-mm", "proximity": "--proximity-mm"})
def contact_map(
    *,
    femur: Annotated[Path, Option(metavar="MESH", help="STL, OBJ or PLY file.")],
    patella: Annotated[Path, Option(metavar="MESH", help="The button's or the cartilage's mesh.")],
    poses: Annotated[
        Path, Option(metavar="FILE", help="CSV: time_s, BODY_px_m ... BODY_qz. STO: time, BODY_T11 ... BODY_T44.")
    ],
    units: Annotated[str, Option(metavar="m|mm", help="Unit of the meshes' coordinates.")],
    patella_units: Annotated[
        str | None, Option(metavar="m|mm", help="Unit of the patella's mesh, if different.")
    ] = None,
    bodies: Annotated[str, Option(metavar="FEMUR,PATELLA", help="Names in the pose file.")] = "femur,patella",
    law: Annotated[str, Option(metavar="linear|logarithmic", help="Law of pressure over depth.")] = "linear",
    modulus: Annotated[str, Option("--modulus-mpa", help="Elastic modulus, or femur's,patella's.")] = "46.3",
    poisson: Annotated[str, Option(help="Poisson ratio, or femur's,patella's.")] = "0.46",
    thickness: Annotated[str, Option(help="Layer thickness, or femur's,patella's [mm].")] = "5 mm",
    rate: RateOption = None,
    start: Annotated[float | None, Option("--from", help="First time [s].")] = None,
    end: Annotated[float | None, Option("--to", help="Last time [s].")] = None,
    lateral: Annotated[
        str | None, Option(metavar="AXIS", help="For --figure: the femur's axis that points laterally, as in -z.")
    ] = None,
    proximity: Annotated[str, Option(metavar="LENGTH", help="Largest gap to report [mm].")] = "1 mm",
    output: Annotated[
        Path | None, Option("-o", "--output", metavar="OUT.nc", help="NetCDF file with all results.")
    ] = None,
    figure: Annotated[Path | None, Option(metavar="OUT.png", help="Figure of pressure, path and time courses.")] = None,
    json: terminal.JsonOption = None,
) -> None:
    """Compute contact at recorded poses: force, moment, area, pressure, its centre and proximity at every frame.

    Nothing is simulated: the overlap of the surfaces at the poses deforms elastic layers on both.

    Example: `pftwin contact-map --femur femur.stl --patella button.stl --units m --poses poses.csv -o contact.nc`
    """
    terminal.check_figure(figure)
    terminal.check_outputs(output, figure, json)
    largest_gap = 1e-3 * amount(proximity, "mm", "--proximity", least=0, most=10)
    outwards = None if lateral is None else _axis(lateral, figure)
    layers = _layers(modulus, poisson, thickness)
    terminal.start_computing()
    rule = _law(law, layers)
    from pftwin.files.result_files import save_dataset
    from pftwin.geometry.contact.depth_sides import pressed_surface, pressing_surface
    from pftwin.studies.contact_map.figures import compressed, dataset, map_figure
    from pftwin.studies.contact_map.mapping import check_outcome, check_sides, load_pair, map_contact

    with terminal.spinner("reading"):
        thigh, button = load_pair(femur, patella, units=units, patella_units=patella_units)
        relative = _poses(poses, bodies, rate, start, end)
        check_sides(thigh, button, relative)
        surfaces = pressed_surface(thigh), pressing_surface(button)
    with terminal.progress("frames") as done:
        found = map_contact(*surfaces, rule, relative, triangles=len(button.faces), band=largest_gap, progress=done)
    missing = relative.times.size - found.times.size
    if not missing:
        check_outcome(found, relative)
    settings = {
        "femur": str(femur),
        "patella": str(patella),
        "poses": str(poses),
        "law": law,
        "modulus_MPa": modulus,
        "poisson_ratio": poisson,
        "thickness_mm": ",".join(f"{t:g}" for t in listed(thickness, "mm", "--thickness")),
    }
    if missing:
        settings["title"] = f"contact at given poses (interrupted: {found.times.size} of {relative.times.size} frames)"
    with report_written_on_interrupt(output, figure):
        if output is not None:
            data = dataset(found, button, {**settings, "source": f"pftwin {__version__}"})
            with terminal.spinner("writing"):
                save_dataset(data, output, encoding=compressed(data))
        if missing:
            raise Interrupted(output)
        if figure is not None:
            with terminal.spinner("drawing"):
                title = f"{patella.name} on {femur.name}, {law} foundation"
                sides = None if outwards is None else _in_both_frames(outwards, relative)
                terminal.save_picture(map_figure(found, thigh, button, title, lateral=sides), figure)
    facts = _facts(found)
    terminal.present({**settings, **facts}, _summary(facts), terminal.written_line([output, figure]), json=json)
    if deep := int(found.too_deep.sum()):
        exit_flagged(f"in {deep} of {found.times.size} frames one part is deeper in the other than any joint bears")


def _summary(facts: dict[str, Any]) -> str:
    return (
        f"{facts['frames_in_contact']} of {facts['frames']} frames in contact; "
        f"at most {facts['largest_force_N']:.4g} N, {facts['largest_pressure_MPa']:.3g} MPa, "
        f"{facts['largest_area_mm2']:.3g} mm^2, {facts['largest_depth_mm']:.2g} mm deep"
    )


def _layers(modulus: str, poisson: str, thickness: str) -> list[tuple[float, float, float]]:
    """Modulus [Pa], Poisson ratio and thickness [m] of the femur's and the patella's layer."""
    thick, moduli = _one_or_two("--thickness", thickness, "mm"), _one_or_two("--modulus-mpa", modulus)
    numbers = zip(moduli, _one_or_two("--poisson", poisson), thick, strict=True)
    return [(1e6 * e, nu, 1e-3 * t) for e, nu, t in numbers]


def _law(name: str, layers: list[tuple[float, float, float]]) -> FoundationLaw:
    """The named law from each layer's modulus, Poisson ratio and thickness (SI units), the femur's layer first."""
    from pftwin.model.effects.foundation_law import LAWS, checked_layer

    if name not in LAWS:
        raise InputError(f"no law {name!r}", where="--law", expected=" or ".join(LAWS))
    bodies = "femur's", "patella's"
    return LAWS[name](*(checked_layer(*layer, where=f"{b} layer") for b, layer in zip(bodies, layers, strict=True)))


def _one_or_two(option: str, text: str, unit: str = "") -> list[float]:
    """Parses one number for both layers, or one each for femur and patella, with an optional unit."""
    values = listed(text, unit, option)
    if len(values) not in (1, 2):
        raise InputError(f"found {text!r}", where=option, expected="a number, or two: femur's,patella's")
    return values * 2 if len(values) == 1 else values


def _poses(path: Path, bodies: str, rate: float | None, start: float | None, end: float | None) -> PoseSeries:
    """Poses of the patella in the femur within the requested times."""
    from pftwin.files.mocap import read_poses

    names = bodies.split(",")
    if len(names) != 2:
        raise InputError(f"found {bodies!r}", where="--bodies", expected="two names: FEMUR,PATELLA")
    found = read_poses(path, names, rate=rate)
    relative = found[names[1]].relative_to(found[names[0]])
    first, last = float(relative.times[0]), float(relative.times[-1])
    return relative.between(first if start is None else start, last if end is None else end)


def _axis(text: str, figure: Path | None) -> Direction:
    """Parses an axis of the femur's mesh; InputError for other text, or if no figure is requested."""
    if figure is None:
        problem = "names the sides of a figure, and none is drawn"
        raise InputError(problem, where="--lateral", remedy="--figure OUT.png")
    found = axis_named(text)
    if found is None:
        raise InputError(
            f"found {text!r}", where="--lateral", expected="an axis of the femur's mesh, as in --lateral=-z"
        )
    return found


def _in_both_frames(direction: Direction, poses: PoseSeries) -> tuple[Any, Any]:
    """A direction in the femur frame, and the same in the patella frame halfway through the recording."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(poses.quaternions[poses.times.size // 2], scalar_first=True)
    return np.array(direction), turn.inv().apply(direction)


def _facts(found: ContactMap) -> dict[str, Any]:
    import numpy as np

    from pftwin.dynamics.status import Status, status_facts

    separate = np.where(found.touching, 0, int(Status.NO_CONTACT))
    flags = separate | np.where(found.too_deep, int(Status.DEEP_INDENTATION), 0)
    return {
        "frames": found.times.size,
        "frames_in_contact": int(found.touching.sum()),
        "frames_too_deep": int(found.too_deep.sum()),
        **status_facts(flags),
        "largest_force_N": float(np.linalg.norm(found.force, axis=1).max()),
        "largest_pressure_MPa": float(found.max_pressure.max() / 1e6),
        "largest_area_mm2": float(1e6 * found.area.max()),
        "largest_depth_mm": float(1e3 * found.largest_depth.max()),
    }
