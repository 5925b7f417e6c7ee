"""`python -m vmf_docs`: everything; with `--no-run` without the commands of the pages, in seconds."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
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


def main(arguments: Sequence[str]) -> int:
    """Check every page, write what is generated, build the HTML; 1, with nothing written, if one is wrong.

    Raises
    ------
    SystemExit : 0 after `--help`, 2 where an argument is unknown; nothing is checked, run or written.
    """
    no_run = _options().parse_args(arguments).no_run
    pages = {name: Page.read(path) for name, path in PAGES.items() if name != "reference"}
    pages = {name: pages.get(name) or Page(path, reference()) for name, path in PAGES.items()}
    wrong = [line for page in pages.values() for line in page.wrong_formulas]
    wrong += links.broken_links(pages.values(), ROOT)
    for line in wrong:
        print(line, file=sys.stderr)
    if wrong:
        return 1
    PAGES["reference"].write_text(pages["reference"].text, encoding="utf-8")
    if not no_run:
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


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m vmf_docs",
        description="Check the pages, run the commands on them (minutes), put in what these print and draw, "
        "and build the HTML.",
        allow_abbrev=False,
    )
    parser.add_argument("--no-run", action="store_true", help="leave out the commands: seconds")
    return parser


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except tutorial.TutorialError as error:
        sys.exit(str(error))
