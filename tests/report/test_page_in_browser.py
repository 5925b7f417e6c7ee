"""The page in headless Chromium: on a phone, on a desk, dark, and printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from chromium import Browser, program

from vmf.experiment import RunOptions, run_experiment, run_study
from vmf.experiment.reporting import report
from vmf.report.page import thesis
from vmf.spec import load, load_study

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PAGES = ("thesis", "runs")
MINI = ("data.simulate.frames=30", "evaluate.trials=2", "evaluate.checkpoints=null", "evaluate.beyond=[]")
MINI += ("evaluate.queries=4", "evaluate.curve_points=6", "evaluate.bootstrap=20")
# What makes the run of pan and tilt that the page counts.
COMMAND = next(figure.command for figure in thesis().figures if figure.config == "pan_tilt")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of the thesis and one of any runs, both from two miniature runs."""
    out = tmp_path_factory.mktemp("runs")
    trained = run_experiment(load(CONFIGS / "thesis/pan_tilt.yaml", MINI), COMMAND, RunOptions(out)).run_dir
    studied = run_study(load_study(CONFIGS / "thesis/stereo_codes.yaml"), out).run_dir
    made = {name: out / f"{name}.html" for name in PAGES}
    for name, path in made.items():
        result = report([trained, studied], path, about_thesis=name == "thesis")
        assert (result.runs, result.losses) == (2, ())
        assert result.size == path.stat().st_size
    return made


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    executable = program()
    if executable is None:
        pytest.skip("no chromium here (Debian: apt-get install chromium)")
    with Browser(executable, tmp_path_factory.mktemp("profile")) as found:
        yield found


def look_at(browser: Browser, page: Path, width: int, dark: bool = False) -> None:
    """Load a page, and hear no complaint and no request but for the page itself."""
    browser.complaints.clear()
    browser.requests.clear()
    browser.open(page.as_uri(), width, dark=dark)
    assert browser.complaints == []
    outside = [url for url in browser.requests if not url.startswith("data:")]
    assert outside == [page.as_uri()]


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("width", [360, 1200])
def test_it_fits_the_window_and_every_image_loads(
    name: str, width: int, pages: dict[str, Path], browser: Browser
) -> None:
    look_at(browser, pages[name], width)
    assert browser.evaluate("window.innerWidth") == width
    for opened in (False, True):
        # What is folded away must fit, too.
        browser.evaluate(f"document.querySelectorAll('details').forEach(d => d.open = {str(opened).lower()})")
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        beyond = browser.evaluate(
            "[...document.querySelectorAll('body *')].filter(e => !e.closest('.scroll, pre, .skip')"
            f" && e.getBoundingClientRect().right > {width} + 0.5).map(e => e.outerHTML.slice(0, 80))"
        )
        assert beyond == []
    broken = "[...document.images].filter(i => !i.complete || !i.naturalWidth || !i.alt).length"
    assert browser.evaluate(broken) == 0
    assert browser.evaluate("document.images.length") >= 5


@pytest.mark.parametrize("width", [360, 1200])
def test_every_number_at_the_top_says_of_which_figure_it_is(
    width: int, pages: dict[str, Path], browser: Browser
) -> None:
    look_at(browser, pages["thesis"], width)
    rows = browser.evaluate(
        "[...document.querySelectorAll('#everything + .scroll tbody tr')].map(r => r.innerText.trim())"
    )
    figures = [figure.id for figure in thesis().figures for _ in figure.claims]
    assert len(rows) == len(figures)
    for row, figure in zip(rows, figures, strict=True):
        assert row.startswith(figure)
        # Once: in the column where there is room for one, else above the quantity.
        assert not row.removeprefix(figure).strip().startswith(figure)


@pytest.mark.parametrize("name", PAGES)
def test_every_anchor_leads_somewhere(name: str, pages: dict[str, Path], browser: Browser) -> None:
    look_at(browser, pages[name], 1200)
    lost = browser.evaluate(
        "[...document.querySelectorAll('a[href^=\"#\"]')].map(a => a.getAttribute('href').slice(1))"
        ".filter(id => document.querySelectorAll('#' + CSS.escape(id)).length !== 1)"
    )
    assert lost == []
    assert browser.evaluate("document.querySelectorAll('[id]').length") == browser.evaluate(
        "new Set([...document.querySelectorAll('[id]')].map(e => e.id)).size"
    )
    last = browser.evaluate("[...document.querySelectorAll('section')].at(-1).id")
    browser.evaluate(f"location.hash = '#{last}'")
    top = browser.evaluate(f"document.getElementById('{last}').getBoundingClientRect().top")
    height = browser.evaluate("window.innerHeight")
    assert top < height


@pytest.mark.parametrize("name", PAGES)
def test_those_who_listen_can_read_it(name: str, pages: dict[str, Path], browser: Browser) -> None:
    look_at(browser, pages[name], 1200)
    assert browser.evaluate("document.documentElement.lang") == "en"
    assert browser.evaluate("document.querySelectorAll('h1').length") == 1
    levels = browser.evaluate("[...document.querySelectorAll('h1, h2, h3')].map(h => +h.tagName[1])")
    assert all(after - before <= 1 for before, after in pairwise(levels))
    bare = "[...document.querySelectorAll('table')].filter(t => !t.caption || !t.tHead).length"
    assert browser.evaluate(bare) == 0
    assert browser.evaluate("document.querySelectorAll('table').length") > 0
    # Boxes that scroll are reached by keyboard and have a name.
    nameless = (
        "[...document.querySelectorAll('.scroll')].filter(b => b.tabIndex !== 0 || !b.ariaLabel).length"
    )
    assert browser.evaluate(nameless) == 0


CONTRAST = """
(() => {
  const light = c => {
    const [r, g, b] = c.match(/[\\d.]+/g).map(Number).slice(0, 3)
      .map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = e => {
    for (; e; e = e.parentElement) {
      const c = getComputedStyle(e).backgroundColor;
      if (!c.endsWith(", 0)")) return c;
    }
    return "rgb(255, 255, 255)";
  };
  return Math.min(...[...document.querySelectorAll("p, a, td, th, dd, .verdict, summary, code")].map(e => {
    const [a, b] = [light(getComputedStyle(e).color), light(ground(e))].sort((x, y) => x - y);
    return (b + 0.05) / (a + 0.05);
  }));
})()
"""


@pytest.mark.parametrize("dark", [False, True])
def test_text_stands_out_from_its_ground_by_day_and_by_night(
    dark: bool, pages: dict[str, Path], browser: Browser
) -> None:
    look_at(browser, pages["thesis"], 1200, dark=dark)
    # WCAG 2, level AA.
    assert browser.evaluate(CONTRAST) >= 4.5
    ground = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") is not dark


@pytest.mark.parametrize("name", PAGES)
def test_it_prints(name: str, pages: dict[str, Path], browser: Browser) -> None:
    look_at(browser, pages[name], 1200)
    printed = browser.printed()
    assert printed.startswith(b"%PDF-")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 2


def test_the_page_says_what_was_run_and_what_was_not(pages: dict[str, Path]) -> None:
    text = pages["thesis"].read_text()
    for figure in thesis().figures:
        assert f'id="{figure.anchor}"' in text
    assert f"vmf {COMMAND} configs/thesis/pan_tilt.yaml data.simulate.frames=30" in text
    assert "2 trials, 30 frames" in text
    assert "not run: pan_tilt_disturbed" in text
    runs = pages["runs"].read_text()
    assert "kind: stereo_codes" in runs
    assert "Mean (median) absolute error, held out, frame=30" in runs


def test_nothing_is_fetched_and_nothing_runs(pages: dict[str, Path]) -> None:
    for page in pages.values():
        text = page.read_text()
        assert "<script" not in text
        assert not re.search(r'(?:src|href)="(?!data:|#)', text)
