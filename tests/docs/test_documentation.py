"""The documentation as it is committed: links, the reference, the tutorial's specs, and its HTML."""

import shlex
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from vmf_docs import links, site, tutorial
from vmf_docs.__main__ import PAGES, ROOT, RUN
from vmf_docs.pages import Page
from vmf_docs.reference import documented_models, meanings, reference

from vmf.spec import load, load_study

ALL = {name: Page.read(path) for name, path in PAGES.items()}
SPECS = {
    block.words[1]: block.text
    for name in RUN
    for block in ALL[name].blocks
    if block.words[:1] == ("yaml",) and len(block.words) == 2
}


def commands():
    """Each `vmf …` command that the pages run, as words, without what its output is piped into."""
    for name in RUN:
        for block in ALL[name].blocks:
            if block.words[:2] == ("sh", "run"):
                for line in block.text.replace("\\\n", " ").splitlines():
                    if line.startswith("vmf "):
                        yield shlex.split(line.partition(" | ")[0])[1:]


LOADERS = {"train": load, "compare-3d": load, "study": load_study}
SPECS_RUN = [words for words in commands() if words[0] in LOADERS]


def test_every_link_leads_somewhere():
    assert links.broken_links(ALL.values(), ROOT) == []


def test_every_page_is_in_the_menu():
    assert {path.resolve() for path in (ROOT / "docs").glob("*.md")} <= {p.resolve() for p in PAGES.values()}


def test_every_picture_is_used():
    used = {links.file_and_anchor(p.path, t.text)[0] for p in ALL.values() for t in p.targets if t.is_picture}
    assert {path.resolve() for path in (ROOT / "docs" / "pictures").iterdir()} <= used


def test_the_reference_is_that_of_the_models():
    assert PAGES["reference"].read_text(encoding="utf-8") == reference(), "run `make pages`"


@pytest.mark.parametrize("model", documented_models(), ids=lambda model: model.__name__)
def test_every_key_has_a_meaning(model):
    assert set(model.model_fields) - {"kind"} <= set(meanings(model))


def test_every_model_is_in_the_reference():
    text = PAGES["reference"].read_text(encoding="utf-8")
    for model in documented_models():
        for key in set(model.model_fields) - {"kind"}:
            assert f"| `{key}` |" in text, f"{model.__name__}.{key}"


def test_the_pages_run_experiments():
    assert len(SPECS_RUN) >= 8


@pytest.mark.parametrize("words", SPECS_RUN, ids=" ".join)
def test_specs_and_overrides_are_accepted(words, tmp_path):
    path = tmp_path / words[1]
    path.write_text(SPECS[words[1]], encoding="utf-8")
    LOADERS[words[0]](path, [word for word in words[2:] if not word.startswith("--")])


@pytest.mark.long
def test_a_study_prints_what_its_page_shows(tmp_path):
    results = ALL["results"]
    lines = results.text.splitlines(keepends=True)
    at = results.text[: results.text.index("\n## Studies\n")].count("\n")
    part = Page(tmp_path / "results.md", "".join(lines[at:]))
    (tmp_path / "work").mkdir()
    again = tutorial.run(part, tmp_path / "work", Path(sys.executable).parent, str)
    assert again == part.text
    assert (tmp_path / "pictures" / "study.png").stat().st_size > 10_000


class Addresses(HTMLParser):
    """What a built page loads and links to, and the places in it."""

    def __init__(self, text: str):
        super().__init__()
        self.links, self.loads, self.ids = [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        of = dict(attrs)
        self.ids |= {of["id"]} if "id" in of else set()
        self.links += [of["href"]] if tag == "a" else []
        self.loads += [of[key] for key in ("src", "href") if tag in ("img", "link", "script") and key in of]


def test_html_opens_from_disk(tmp_path):
    built = site.build(ALL, tmp_path / "html")
    read = {path.resolve(): Addresses(path.read_text(encoding="utf-8")) for path in built}
    assert len(read) == len(PAGES)
    for path, page in read.items():
        for address in page.loads:
            assert not links.is_elsewhere(address), "nothing may come from the network"
            assert (path.parent / address).is_file()
        for address in page.links:
            if links.is_elsewhere(address):
                continue
            name, _, anchor = unquote(address).partition("#")
            to = (path.parent / name).resolve() if name else path
            assert to.exists(), address
            assert to.suffix != ".md", f"{address} is not HTML"
            if anchor:
                assert anchor in read[to].ids, address


def test_mathematics_is_rendered_at_build():
    html = ALL["method"].html({})
    assert html.count("<math") > 20
    assert "$" not in html
    assert "\\" not in html
