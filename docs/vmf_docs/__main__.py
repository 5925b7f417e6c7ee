"""`python -m vmf_docs`: everything; with `--no-run` without the commands of the pages, in seconds."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from vmf_docs import links, site, tutorial
from vmf_docs.pages import Page
from vmf_docs.reference import reference

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
BUILT = DOCS / "_build"
# In the order of the menu, with their names there and in HTML.
PAGES = {
    "index": DOCS / "README.md",
    "tutorial": DOCS / "tutorial.md",
    "results": DOCS / "results.md",
    "method": DOCS / "method.md",
    "reference": DOCS / "reference.md",
    "performance": DOCS / "performance.md",
    "project": ROOT / "README.md",
}
# Pages whose commands are run.
RUN = ("tutorial", "results")


def main(arguments: list[str]) -> int:
    """Check every page, write what is generated, build the HTML; 1, with nothing written, if one is wrong."""
    pages = {name: Page.read(path) for name, path in PAGES.items() if name != "reference"}
    pages = {name: pages.get(name) or Page(path, reference()) for name, path in PAGES.items()}
    wrong = [line for page in pages.values() for line in page.wrong_formulas]
    wrong += links.broken_links(pages.values(), ROOT)
    for line in wrong:
        print(line, file=sys.stderr)
    if wrong:
        return 1
    PAGES["reference"].write_text(pages["reference"].text, encoding="utf-8")
    if "--no-run" not in arguments:
        work = BUILT / "work" / "vmf"
        shutil.rmtree(BUILT / "work", ignore_errors=True)
        work.mkdir(parents=True)
        if (ROOT.parent / "shared").exists():
            (work.parent / "shared").symlink_to(ROOT.parent / "shared")
        for name in RUN:
            text = tutorial.run(pages[name], work, Path(sys.executable).parent, print)
            pages[name] = Page(PAGES[name], text)
            PAGES[name].write_text(text, encoding="utf-8")
    print(f"{site.build(pages, BUILT / 'html')[0]}: {len(pages)} pages")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except tutorial.TutorialError as error:
        sys.exit(str(error))
