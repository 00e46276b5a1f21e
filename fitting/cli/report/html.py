"""Pieces of the page: every text is escaped, every picture is inside the page, and nothing is fetched."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Belt and braces: a browser that keeps to this policy fetches nothing, whatever the page holds.
_POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; worker-src blob: data:; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob: data:; connect-src blob: data:; frame-src 'self'; "
    "form-action 'none'"
)

_MOST_WHOLE = 1e6  # numbers below are written out, above as powers of ten


class PageSection(NamedTuple):
    """A part of the page under a heading."""

    key: str  # its anchor
    title: str
    body: str  # HTML


def paragraph(text: str, kind: str = "") -> str:
    """Plain text as a paragraph; `kind` is a class of the style sheet."""
    return f'<p class="{escape(kind)}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """A list; nothing where there is nothing to say."""
    items = "".join(f"<li>{escape(t)}</li>" for t in texts)
    return f"<ul>{items}</ul>" if items else ""


def subtitle(text: str) -> str:
    """A heading below a section's."""
    return f"<h3>{escape(text)}</h3>"


def table(caption: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column names its rows; other columns are set to the right where all of them are numbers."""
    lines = [tuple(r) for r in rows]
    right = [i > 0 and all(_numeric(line[i]) for line in lines) for i in range(len(headings))]
    kinds = [' class="number"' if r else "" for r in right]
    head = "".join(f'<th scope="col"{k}>{escape(h)}</th>' for h, k in zip(headings, kinds, strict=True))
    body = "".join(
        f'<tr><th scope="row">{escape(first)}</th>'
        + "".join(f"<td{k}>{escape(c)}</td>" for c, k in zip(rest, kinds[1:], strict=True))
        + "</tr>"
        for first, *rest in lines
    )
    return (
        f'<div class="wide"><table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def picture(data: bytes, kind: str, alternative: str, caption: str) -> str:
    """A picture inside the page. An SVG stands in an image too: there its scripts, had it any, are dead.

    Args:
        data: of the file.
        kind: "png" or "svg+xml".
        alternative: what it shows, for those who do not see it.
        caption: below it.
    """
    code = base64.b64encode(data).decode("ascii")
    return (
        f'<figure><img src="data:image/{kind};base64,{code}" alt="{escape(alternative)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def drawn(figure: Figure, alternative: str, caption: str) -> str:
    """A figure of matplotlib's, as SVG inside the page."""
    from pftwin.results.plots import house_style

    target = io.BytesIO()
    with house_style():
        figure.savefig(target, format="svg", metadata={"Date": None})
    return picture(target.getvalue(), "svg+xml", alternative, caption)


def frame(page: str, title: str) -> str:
    """A page within the page. It may run its scripts, and reaches nothing of the page around it.

    Its base is no address: k3d's style sheet names fonts beside the page, which browsers would look for there.
    """
    page = page.replace("<head>", '<head><base href="about:invalid">', 1)
    return (
        f'<iframe class="view" sandbox="allow-scripts" title="{escape(title)}" srcdoc="{escape(page)}"></iframe>'
        '<p class="on-paper">The moving knee is in the file only: open the page in a browser.</p>'
    )


def page(title: str, labels: Sequence[tuple[str, str]], sections: Sequence[PageSection], ending: str) -> str:
    """The whole document.

    Args:
        title: of the page.
        labels: what has to be said above everything: a word in bold, and a sentence.
        sections: in their order.
        ending: the last line.
    """
    style = (files("fitting.cli.report") / "report.css").read_text(encoding="utf-8")
    style += _on_every_sheet(title, " ".join(word.rstrip(".:") + "." for word, _ in labels))
    told = "".join(f'<p class="label"><strong>{escape(w)}</strong> {escape(s)}</p>' for w, s in labels)
    links = "".join(f'<li><a href="#{escape(s.key)}">{escape(s.title)}</a></li>' for s in sections)
    parts = "".join(
        f'<section id="{escape(s.key)}" aria-labelledby="{escape(s.key)}-title">'
        f'<h2 id="{escape(s.key)}-title">{escape(s.title)}</h2>{s.body}</section>\n'
        for s in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><div role="note">{told}</div></header>\n'
        f'<nav aria-label="Contents"><ol>{links}</ol></nav>\n<main>\n{parts}</main>\n'
        f"<footer>{paragraph(ending)}</footer>\n</body>\n</html>\n"
    )


def _on_every_sheet(title: str, labels: str) -> str:
    """Style of a print's margins: title and labels on every sheet of paper, and its number."""
    small = 'font: 8pt system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #333;'
    return (
        "@page {\n"
        f"    @top-left {{ {small} content: {_css_text(title)}; }}\n"
        f"    @bottom-left {{ {small} content: {_css_text(labels)}; }}\n"
        f'    @bottom-right {{ {small} content: counter(page) " / " counter(pages); }}\n'
        "}\n"
    )


def _css_text(words: str) -> str:
    """A string of a style sheet in which every character but letters, digits and the plainest is told by its number."""
    return '"' + "".join(c if c.isalnum() or c in " .,-" else f"\\{ord(c):x} " for c in words) + '"'


def number(value: Any, digits: int = 4) -> str:
    """A number as people read it; a dash where there is none."""
    x = float(value)
    if not np.isfinite(x):
        return "–"
    whole = 10**digits <= abs(x) < _MOST_WHOLE
    return f"{x:{'.0f' if whole else f'.{digits}g'}}".replace("-", "\N{MINUS SIGN}")


def _numeric(text: str) -> bool:
    return not text.strip(" –") or text.strip(" +\N{MINUS SIGN}-")[:1].isdigit()
