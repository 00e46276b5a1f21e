"""Tables of treatments, outcomes and clinical indices, from the definitions that the code itself uses."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from fitting.prediction.clinical_indices import USUAL
from fitting.prediction.outcomes import MEASURES
from fitting.treatments import KINDS

PAGE = "treatments.md"
_INDICES = {
    "tt_tg": ("TT-TG [mm]", "tuberosity to groove, medial-lateral (Goutallier et al. 1978; Dejour et al. 1994)"),
    "q_angle": ("Q-angle [deg]", "between the quadriceps' line of pull and the patellar tendon (Brattström 1964)"),
    "caton_deschamps": ("Caton-Deschamps", "patellar height (Caton et al. 1982)"),
    "sulcus_angle": ("sulcus angle [deg]", "between the facets (Brattström 1964; Merchant et al. 1974)"),
    "lateral_trochlear_inclination": ("lateral inclination [deg]", "of the lateral facet (Carrillon et al. 2000)"),
}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Puts the tables where the page asks for them."""
    return filled(markdown) if page.file.src_uri == PAGE else markdown


def filled(markdown: str) -> str:
    """The page with its tables."""
    for name, table in (("treatments", treatments()), ("outcomes", outcomes()), ("indices", indices())):
        mark = f"<!-- table: {name} -->"
        if mark not in markdown:
            raise ValueError(f"{PAGE} has no place for its table of {name}: {mark}")
        markdown = markdown.replace(mark, table)
    return markdown


def treatments() -> str:
    """Each kind with its amounts and what a positive one does."""
    rows = (
        (f"`{name}`", kind.part, "; ".join(f"`{a}` [{w.unit}]: {w.more}" for a, w in kind.amounts.items()))
        for name, kind in KINDS.items()
    )
    return _table(("function", "changes", "amounts, and what a positive one does"), rows)


def outcomes() -> str:
    """Each outcome with its unit and meaning."""
    return _table(("outcome", "unit", "meaning"), ((f"`{n}`", m.unit, m.long_name) for n, m in MEASURES.items()))


def indices() -> str:
    """Each index with its source and what is usual."""
    if set(_INDICES) != set(USUAL):
        raise ValueError(f"indices and norms differ: {sorted(set(_INDICES) ^ set(USUAL))}")
    return _table(("index", "what it is", "usual"), ((*_INDICES[n], usual) for n, usual in USUAL.items()))


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)
