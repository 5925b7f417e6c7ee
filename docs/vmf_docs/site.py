"""HTML that opens from disk: every page, its pictures, one style sheet, nothing from the network."""

from __future__ import annotations

import html
import os
import shutil
from pathlib import Path
from string import Template

from pygments.formatters import HtmlFormatter

from vmf_docs.links import file_and_anchor, is_elsewhere
from vmf_docs.pages import Page

_HERE = Path(__file__).parent


def build(pages: dict[str, Page], out: Path) -> list[Path]:
    """Write `NAME.html` for every named page, the first of them first in the menu; return the files.

    Links between pages become links between their HTML; pictures are copied; links to other files of the
    project lead from `out` to where they are.
    """
    if out.exists():
        shutil.rmtree(out)
    (out / "pictures").mkdir(parents=True)
    style = (_HERE / "style.css").read_text(encoding="utf-8")
    (out / "style.css").write_text(style + HtmlFormatter().get_style_defs("pre"), encoding="utf-8")
    template = Template((_HERE / "page.html").read_text(encoding="utf-8"))
    names = {page.path.resolve(): name for name, page in pages.items()}
    written = []
    for name, page in pages.items():
        rewritten = {
            target.text: _moved(page, target.text, target.is_picture, names, out) for target in page.targets
        }
        menu = "\n".join(_entry(other, other == name) for other in pages)
        path = out / f"{name}.html"
        path.write_text(
            template.substitute(title=html.escape(page.title), menu=menu, body=page.html(rewritten)),
            encoding="utf-8",
        )
        written.append(path)
    return written


def _moved(page: Page, target: str, is_picture: bool, names: dict[Path, str], out: Path) -> str:
    if is_elsewhere(target):
        return target
    path, anchor = file_and_anchor(page.path, target)
    behind = f"#{anchor}" if anchor else ""
    if path in names:
        return f"{names[path]}.html{behind}"
    if is_picture:
        shutil.copy(path, out / "pictures" / path.name)
        return f"pictures/{path.name}"
    return os.path.relpath(path, out.resolve()) + behind


def _entry(name: str, is_here: bool) -> str:
    here = ' aria-current="page"' if is_here else ""
    return f'<a href="{name}.html"{here}>{html.escape(name.capitalize())}</a>'
