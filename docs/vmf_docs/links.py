"""Links between pages, to files and to headings: all have to lead somewhere. The network is not asked."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote

from vmf_docs.pages import Page


def is_elsewhere(target: str) -> bool:
    """Whether a link leaves the project."""
    return target.startswith(("https://", "http://", "mailto:"))


def file_and_anchor(page: Path, target: str) -> tuple[Path, str]:
    """Return the file that a link in `page` points to, and what stands behind its `#`."""
    name, _, anchor = target.partition("#")
    return (page.parent / unquote(name)).resolve() if name else page.resolve(), unquote(anchor)


def broken_links(pages: Iterable[Page], root: Path) -> list[str]:
    """Return one line for each link that leads nowhere, or out of the project at `root`."""
    read = {page.path.resolve(): page for page in pages}
    found = []
    for page in list(read.values()):
        for target in page.targets:
            if is_elsewhere(target.text):
                continue
            path, anchor = file_and_anchor(page.path, target.text)
            place = f"{page.path}:{target.line}: {target.text}"
            if not path.is_relative_to(root.resolve()):
                found.append(f"{place} is outside of the project")
            elif not path.exists():
                found.append(f"{place}: no such file")
            elif anchor:
                if path not in read and path.suffix == ".md":
                    read[path] = Page.read(path)
                if path not in read or anchor not in read[path].anchors:
                    found.append(f"{place}: no such heading")
    return found
