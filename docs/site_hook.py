"""Hook of MkDocs: pages beside docs/, and the files of the code that pages link to, as pages of the site.

The pages are written for GitHub, where a link like ``../planning/search.py`` leads to the file. Here each such file
becomes a page with its text; the README is the first page.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BESIDE = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Pages of the repository outside of docs/, and their names on the site."""
_LINK = re.compile(r"(?P<before>!?\[(?:[^\[\]]|\[[^\]]*\])*\]\()(?P<to>[^)\s#]+)(?P<anchor>#[^)\s]*)?\)")
_DIAGRAM = re.compile(r"```mermaid\n.*?```\n", re.DOTALL)
"""GitHub draws it. A browser would have to load what does so from elsewhere; the tables below it say the same."""
_LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "sh", ".json5": "js", ".json": "json", ".service": "ini"}
_ELSEWHERE = ("http:", "https:", "mailto:")


def on_files(files: Files, config: Any) -> Files:
    """Add README, changelog and contributing, and a page of every file of the repository that some page links to."""
    for name, page in BESIDE.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text()))
    sources = [DOCS / one.src_uri for one in files.documentation_pages() if one.src_uri not in BESIDE.values()]
    texts = [(page, page.read_text()) for page in sources] + [(ROOT / one, (ROOT / one).read_text()) for one in BESIDE]
    for file in sorted({one for page, text in texts for one in _linked(page, text)}):
        files.append(File.generated(config, _page_of(file), content=_as_page(file)))
    return files


def on_page_markdown(text: str, page: Any, **_: Any) -> str:
    """Lead every link to where its target is on the site; a link to a folder of the code becomes its words."""
    by_page = {shown: name for name, shown in BESIDE.items()}
    here = page.file.src_uri
    if here.startswith("source/"):
        return text
    at = ROOT / by_page[here] if here in by_page else DOCS / here
    text = _DIAGRAM.sub("", text)
    return _LINK.sub(lambda link: _led(link, at, here), text)


def _led(link: re.Match[str], page: Path, here: str) -> str:
    """The link as the site has it; ``page``: the file it stands in, ``here``: that page on the site."""
    target = _target(page, link["to"])
    if target is None:
        return link[0]
    if target.is_dir():
        return re.sub(r"^!?\[|\]\($", "", link["before"])
    to = os.path.relpath(_page_of(target), Path(here).parent)
    return f"{link['before']}{to}{link['anchor'] or ''})"


def _linked(page: Path, text: str) -> set[Path]:
    """The files of the repository that a page links to and that are no pages of the site by themselves."""
    targets = {_target(page, link["to"]) for link in _LINK.finditer(text)}
    return {one for one in targets if one is not None and one.is_file() and _page_of(one).startswith("source/")}


def _target(page: Path, link: str) -> Path | None:
    if link.startswith(_ELSEWHERE):
        return None
    return (page.parent / link).resolve()


def _page_of(file: Path) -> str:
    """Return where a file of the repository is on the site."""
    name = str(file.relative_to(ROOT))
    if name in BESIDE:
        return BESIDE[name]
    if file.is_relative_to(DOCS) and file.suffix != ".py" and not file.is_relative_to(DOCS / "examples"):
        return str(file.relative_to(DOCS))
    return f"source/{name}.md"


def _as_page(file: Path) -> str:
    name = file.relative_to(ROOT)
    text = file.read_text().rstrip()
    return f"---\nsearch:\n  exclude: true\n---\n# {name}\n\n~~~~{_LANGUAGES.get(file.suffix, 'text')}\n{text}\n~~~~\n"
