"""`pftwin init`, `pftwin import` and `pftwin export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from pftwin.base.errors import InputError
from pftwin.base.sheet import Sheet
from pftwin.base.written_amounts import listed
from pftwin.cli import terminal
from pftwin.cli.exit_codes import check_trust_of_files, exit_flagged
from pftwin.cli.scenes import limits

if TYPE_CHECKING:
    from pftwin.files.interchange.osim_scene import Imported
    from pftwin.model.scene import Scene

RateOption = Annotated[
    float | None, Option("--rate", metavar="HERTZ", help="Frame rate, if the time column of a file counts frames.")
]
_MOST_NAMES = 60  # characters of names in a cell of the table; the file not_imported.md has all


def init(
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder for the example; created if it is missing.")],
    *,
    case: Annotated[int, Option(min=1, max=4, help="Case of the virtual rig.")] = 1,
    json: terminal.JsonOption = None,
) -> None:
    """Write a commented example: a scene file with laboratory files (markers, forces, mesh).

    Example: `pftwin init knee`, then `pftwin simulate knee/scene.toml -o knee.nc`
    """
    terminal.check_folder(folder)
    terminal.check_outputs(json)
    from pftwin.rig.scene_template import write_example

    terminal.start_computing()
    with terminal.spinner(f"writing the example to {folder}"):
        files = write_example(folder, case)
    following = f"next: pftwin simulate {folder / 'scene.toml'} -o knee.nc"
    terminal.present({"files": [str(p) for p in files]}, *(f"written: {p}" for p in files), following, json=json)


def export(
    result: Annotated[Path, Argument(metavar="RESULT.nc", help="A result of `pftwin simulate`.")],
    *,
    output: Annotated[
        list[Path],
        Option(
            "-o", "--output", metavar="OUT.(mot|sto|glb|csv)", help="The suffix chooses the format; may be repeated."
        ),
    ],
    axes: terminal.AxesOption = "pftwin",
    json: terminal.JsonOption = None,
) -> None:
    """Convert a result for other programs.

    .mot: joint coordinates for OpenSim, in degrees. .sto: all variables, for OpenSim. .glb: the moving knee, glTF 2.0.
    .csv: all variables, as a table.

    Example: `pftwin export case2.nc -o case2.mot -o case2.glb`, or
    `pftwin export case2.nc --axes isb -o case2.csv`
    """
    from pftwin.files.interchange.exporting import check_format
    from pftwin.files.interchange.exporting import export as write

    for path in output:
        check_format(path, axes)
    terminal.check_outputs(*output, json)
    for path in output:
        with terminal.spinner(f"writing {path}"):
            write(result, path, axes)
    sizes = {str(p): p.stat().st_size for p in output}
    lines = (f"written: {path} ({size / 1e6:.2f} MB)" for path, size in sizes.items())
    terminal.present({"result": str(result), "files": sizes}, *lines, json=json)
    check_trust_of_files(result)


def import_model(
    model: Annotated[Path, Argument(metavar="MODEL.osim", help="A model of OpenSim 4.")],
    *,
    folder: Annotated[Path, Option("-o", "--output", metavar="DIR", help="Folder of the scene.")],
    motion: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="Coordinates over time (.mot), measured poses of the bones (.sto), or recorded markers (.trc, "
            ".c3d, .csv). Default: a synthetic flexion.",
        ),
    ] = None,
    markers: Annotated[
        Path | None, Option(metavar="FILE.xml", help="Marker set to use instead of the model's own.")
    ] = None,
    without: Annotated[list[str] | None, Option(metavar="MARKER", help="A marker to omit; may be repeated.")] = None,
    joint_centers: Annotated[
        bool,
        Option(
            "--joint-centers",
            help="Use the joint centres of hip (from the pelvis) and knee (from the tibia) as markers of the femur.",
        ),
    ] = False,
    units: Annotated[str | None, Option(metavar="m|cm|mm", help="Unit of the markers, if their file has none.")] = None,
    rate: RateOption = None,
    quadriceps: Annotated[
        float | None, Option(metavar="NEWTONS", help="Constant total tension of the muscles from femur to patella.")
    ] = None,
    quadriceps_knots: Annotated[
        str | None,
        Option(
            metavar="DEG,DEG,...",
            help="Flexions of the knee at which to give that tension, so that each can be fitted or changed.",
        ),
    ] = None,
    activation: Annotated[
        str | None,
        Option(
            metavar="A|FILE",
            help="Instead of --quadriceps: activation of the patella's muscles, 0 to 1, or a file of activations "
            "over time (.sto, .mot, .csv); with the muscles' lengths it gives the tensions.",
        ),
    ] = None,
    bend: Annotated[str | None, Option(metavar="COORDINATE", help="Coordinate to flex, without --motion.")] = None,
    side: Annotated[str | None, Option(metavar="right|left", help="Side, if the model has both.")] = None,
    femur: Annotated[str | None, Option(metavar="BODY", help="The femur, if not clear from the names.")] = None,
    tibia: Annotated[str | None, Option(metavar="BODY", help="The tibia, if not clear from the names.")] = None,
    patella: Annotated[str | None, Option(metavar="BODY", help="The patella, if not clear from the names.")] = None,
    geometry: Annotated[
        list[Path] | None, Option(metavar="DIR", help="An additional folder of meshes; may be repeated.")
    ] = None,
    json: terminal.JsonOption = None,
) -> None:
    """Write a scene folder from an OpenSim model: patella, ligaments, contact meshes, and a motion.

    Reports what was omitted and why; not_imported.md in the folder has the complete list. The exit code is 3 if the
    scene was written but needs more input before it can be simulated.

    Example: `pftwin import lenhart2015.osim -o knee`, or
    `pftwin import lenhart2015.osim --motion measured.sto --rate 30 -o knee`, or
    `pftwin import model.osim --motion gait.trc --markers markers.xml -o knee`
    """
    terminal.check_folder(folder)
    terminal.check_outputs(json)
    from pftwin.files.interchange.osim_scene import import_osim
    from pftwin.files.interchange.osim_toml import rows

    knots = None if quadriceps_knots is None else _knots(quadriceps_knots)
    recorded = {"markers": markers, "without": without or (), "joint_centers": joint_centers, "units": units}
    pull = {"quadriceps": quadriceps, "quadriceps_knots": knots, "activation": activation}
    parts = {"femur": femur, "tibia": tibia, "patella": patella, "geometry": geometry or (), "limits": limits.get()}
    options: dict[str, Any] = {**recorded, **pull, **parts}
    terminal.start_computing()
    with terminal.progress(f"reading {model}") as shown:
        shown(0, 2)
        found = import_osim(model, folder, motion=motion, rate=rate, bend=bend, side=side, **options)
        shown(1, 2, what="loading the scene")
        notes, overlap, trouble = _loaded(found)
    facts = {
        "files": [str(p) for p in found.files],
        "notes": notes,
        "not_imported": [part._asdict() for part in found.left_out],
        "tensions_N": found.tensions,
        "start_overlap": overlap,
        "trouble": trouble,
    }
    cells = tuple((kind, _shorten_names(names), why) for kind, names, why in rows(found.left_out))
    sheet = Sheet("not imported", ("what", "names", "why"), cells)
    remark = f"remark: {overlap}" if overlap else ""
    terminal.present(facts, *notes, remark, sheet, terminal.written_line(found.files), json=json)
    if trouble is not None:
        exit_flagged(trouble)
    terminal.show(f"next: pftwin simulate {found.scene} -o knee.nc", json=json)


def _knots(text: str) -> list[float]:
    """Parses flexions of the knee [deg]; InputError for other texts."""
    if found := listed(text, "deg", "--quadriceps-knots"):
        return found
    raise InputError(f"found {text!r}", where="--quadriceps-knots", expected="flexions in degrees, such as 0,30,60")


def _shorten_names(names: str) -> str:
    return names if len(names) <= _MOST_NAMES else f"{names[:_MOST_NAMES]} ... ({names.count(',') + 1})"


def _loaded(found: Imported) -> tuple[list[str], str, str | None]:
    """Notes of importing and loading a scene, a remark on meshes that overlap or "", and why it cannot be simulated
    yet, None if it can.
    """
    from pftwin.dynamics.equilibrium_report import start_overlap
    from pftwin.files.scene_file import load_scene_file

    try:
        loaded = load_scene_file(found.scene)
    except InputError as error:
        return found.notes, "", str(error)
    notes = [*found.notes, *(n for n in loaded.notes if n not in found.notes)]
    return notes, start_overlap(loaded.scene), _still_missing(found, loaded.scene)


def _still_missing(found: Imported, scene: Scene) -> str | None:
    """What the imported scene lacks before it can be simulated; None if nothing."""
    from pftwin.model.limits import upward_lines

    if scene.contact is None:
        return f"{found.scene}: a scene without contact"
    if not found.muscles or found.tensions:
        least = 0 if scene.limits is None else scene.limits.least_upward_lines
        return None if upward_lines(scene) >= least else f"{found.scene}: nothing in it pulls the patella upward"
    can = any(muscle.takes_tension for muscle in found.muscles)
    remedy = "--quadriceps NEWTONS or --activation A" if can else "tables [[prescribed_tension]] of your own"
    names = ", ".join(muscle.name for muscle in found.muscles)
    return f"{found.scene}: muscles of the patella were left out ({names}); try: {remedy}"
