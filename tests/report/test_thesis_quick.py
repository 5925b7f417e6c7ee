"""`make thesis-quick` runs every experiment of the thesis, and its page has a number for every claim."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from chromium import Browser, program
from PIL import Image

from vmf.report.page import thesis
from vmf.report.page.claims import Quantity

ROOT = Path(__file__).resolve().parents[2]
MOST_BYTES = 25_000_000


def make(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run make with this interpreter's programs, whatever environment they are in."""
    command = ["make", *map(str, arguments), "READY=", f"BIN={Path(sys.executable).parent}"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("thesis") / "quick"
    done = make("thesis-quick", f"QUICK_OUT={out}", "JOBS=2")
    assert done.returncode == 0, done.stderr[-2000:]
    return out


@pytest.mark.long
def test_every_figure_is_made_and_every_number_of_a_study_found(out: Path) -> None:
    from vmf.experiment.reporting import finished_runs
    from vmf.report.page import Runs, configs, counted
    from vmf.report.page.measure import measure

    found = [run for path in sorted(out.glob("*-sweep")) for run in finished_runs(path)[0]]
    known = counted(found, thesis(), configs())
    assert (known.others, known.notes) == ((), ())
    runs = Runs(known.runs, known.points)
    lost = []
    for figure in thesis().figures:
        run = runs.newest(figure.config)
        assert run is not None, figure.config
        assert run.plots, figure.config
        assert len(runs.named(figure.sweep)) > 1 or not figure.unknowns, figure.sweep
        for plot in figure.plots:
            assert run.plot(plot if isinstance(plot, str) else plot.name), (figure.config, plot)
        for claim in figure.claims:
            # Few trials may answer nothing, as may a command as printed; what a study says is there.
            for part in (one for one in claim.parts if isinstance(one, Quantity)):
                found = [] if part.case == "vmf[thesis]" else [measure(part, run, runs, "thesis")]
                found += [measure(part, run, runs, "default")] if part.default else []
                if None in found:
                    lost.append((figure.config, part))
    assert lost == []


@pytest.mark.long
def test_no_figure_is_cut_off(out: Path) -> None:
    drawn = sorted(out.glob("*-sweep/**/plots/*.png"))
    assert drawn
    cut_off = []
    for path in drawn:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("L"))
        border = np.concatenate([pixels[[0, -1]].ravel(), pixels[:, [0, -1]].ravel()])
        if (border != pixels[0, 0]).any():
            cut_off.append(path.relative_to(out))
    assert cut_off == []


@pytest.mark.long
def test_its_page_holds_everything_and_fits_a_phone(out: Path, tmp_path: Path) -> None:
    page = out.with_name(f"{out.name}.html")
    assert page.stat().st_size < MOST_BYTES
    text = page.read_text()
    assert "not run" not in text.replace("Not reproduced", "")
    executable = program()
    if executable is None:
        pytest.skip("no chromium here (Debian: apt-get install chromium)")
    with Browser(executable, tmp_path) as browser:
        browser.open(page.as_uri(), 360)
        assert browser.complaints == []
        assert browser.evaluate("document.documentElement.scrollWidth") <= 360
        assert (
            browser.evaluate("[...document.images].filter(i => !i.complete || !i.naturalWidth).length") == 0
        )
        shown = sum(len(figure.claims) for figure in thesis().figures)
        assert browser.evaluate("document.querySelectorAll('#everything + .scroll tbody tr').length") == shown
