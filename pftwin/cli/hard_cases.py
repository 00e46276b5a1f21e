"""`pftwin hard-cases`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pftwin.base.errors import InputError
from pftwin.cli.exit_codes import Interrupted, flagged
from pftwin.cli.terminal import JsonOption, check_outputs, err, out, start_computing, write_json

if TYPE_CHECKING:
    from pftwin.studies.hard_cases import HardCase
    from pftwin.studies.hard_cases import Selection as Selected
    from pftwin.studies.hard_cases.table import KeptPiece
    from pftwin.studies.hard_cases.verdict import Cell

ContactsOption = Annotated[
    list[str] | None,
    typer.Option("--contact", metavar="NAME", help="A kind of contact, again for more; all if left out."),
]
IntegratorsOption = Annotated[
    list[str] | None,
    typer.Option("--integrator", metavar="NAME", help="An integrator, again for more; all if left out."),
]
DtypesOption = Annotated[
    list[str] | None, typer.Option("--dtype", metavar="float64|float32", help="A float type; both if left out.")
]
CasesOption = Annotated[
    list[str] | None, typer.Option("--case", metavar="NAME", help="A case, again for more; all if left out.")
]
MarkdownOption = Annotated[Path | None, typer.Option("--markdown", metavar="FILE", help="Write the page of the docs.")]
FromOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--from",
        metavar="PATH",
        help="Run nothing; show cells kept by --json: a file, or a folder's. Again for more, newest last.",
    ),
]
ListOption = Annotated[
    bool, typer.Option("--list", help="Name the cases and say what is hard about them; run nothing.")
]
QuickOption = Annotated[
    bool, typer.Option("--quick", help="Neither derivatives nor batches side by side: a third of the time.")
]


def hard_cases(
    *,
    case: CasesOption = None,
    contact: ContactsOption = None,
    integrator: IntegratorsOption = None,
    dtype: DtypesOption = None,
    list_: ListOption = False,
    quick: QuickOption = False,
    from_: FromOption = None,
    json: JsonOption = None,
    markdown: MarkdownOption = None,
) -> None:
    """Run the catalogue of scenes that are hard to simulate, and say which pass, fail or are refused.

    Everything takes hours of one core, most of it compiling; one contact with one integrator minutes. Pieces that were
    run one by one, with --json, make one page: --from FOLDER --markdown FILE.

    Example: `pftwin hard-cases --contact P5 --integrator linear_implicit --dtype float64`
    """
    check_outputs(json, markdown)
    start_computing()
    from pftwin.dynamics.integrators import integrator_from_text
    from pftwin.studies.hard_cases import (
        CONTACTS,
        DTYPES,
        INTEGRATORS,
        Selection,
        case_named,
        catalogue,
        method_named,
        table,
    )

    cases = tuple(case_named(n) for n in case) if case else catalogue()
    if list_:
        out(json).print(table.named(cases).table())
        return
    for name in integrator or ():
        integrator_from_text(name)
    chosen = Selection(
        _known(contact, CONTACTS, "--contact"),
        tuple(method_named(n) for n in integrator) if integrator else INTEGRATORS,
        _known(dtype, DTYPES, "--dtype"),
        derivatives=not quick,
        mates=not quick,
    )
    found = [piece for path in from_ for piece in table.read_pieces(path)] if from_ else [_run(cases, chosen, json)]
    order = tuple(c.name for c in catalogue()), CONTACTS, tuple(m.name for m in INTEGRATORS), DTYPES
    cells = table.merged(found, order)
    if markdown is not None:
        from pftwin.base.text_files import write_text

        write_text(markdown, table.markdown(cells, cases, found))
    out(json).print(table.summary(cells).table())
    if table.counts(cells)["fail"]:
        out(json).print(table.reasons(cells, "fail").table())
        flagged(f"{table.counts(cells)['fail']} of {len(cells)} cells fail")


def _run(cases: tuple[HardCase, ...], chosen: Selected, json: str | None) -> KeptPiece:
    """Runs what was chosen, contact by contact; says how far it has come. Ctrl-C keeps the contacts that are done."""
    import time

    from pftwin.base.runtime import describe
    from pftwin.studies.hard_cases import run_matrix
    from pftwin.studies.hard_cases.table import KeptPiece
    from pftwin.studies.runs import run_each

    began = time.perf_counter()

    def one(contact: str) -> list[Cell]:
        say = lambda words: err().print(words, style="dim", highlight=False)  # noqa: E731
        return run_matrix(cases, chosen._replace(contacts=(contact,)), say)

    found = run_each(chosen.contacts, one)
    cells = tuple(cell for of_contact in found for cell in of_contact)
    piece = KeptPiece(cells, time.perf_counter() - began, describe(), not chosen.derivatives)
    write_json(piece.as_dict(), json)
    if len(found) < len(chosen.contacts):
        raise Interrupted(*([Path(json)] if json not in (None, "-") else []))
    return piece


def _known(wanted: list[str] | None, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """What was asked for, or all there is.

    Raises:
        InputError: a name that is not among those known.
    """
    for name in wanted or ():
        if name not in known:
            raise InputError(f"found {name!r}", where=option, expected=f"one of: {', '.join(known)}")
    return tuple(wanted) if wanted else known
