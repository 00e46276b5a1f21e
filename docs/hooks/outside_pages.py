"""Pages that live elsewhere in the repository: the changelog, how to contribute, the notebooks with outputs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
TEXTS = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
_NOTEBOOKS = "notebooks/*.ipynb"


@event_priority(50)  # before the plugin that turns notebooks into pages
def on_files(files: Any, config: Any) -> Any:
    """Adds them to what is found in docs."""
    for source, target in TEXTS.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, target, content=_from_docs(text)))
    for notebook in sorted(ROOT.glob(_NOTEBOOKS)):
        path = notebook.relative_to(ROOT).as_posix()
        files.append(File(path, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """In the repository the notebooks are in ../notebooks as seen from docs; on the site they lie beside the pages."""
    return markdown.replace("](../notebooks/", "](notebooks/")


def _from_docs(text: str) -> str:
    """Links as they are seen from docs."""
    text = re.sub(r"\]\(docs/", "](", text)
    for source, target in TEXTS.items():
        text = text.replace(f"]({source}", f"]({target}")
    return text
