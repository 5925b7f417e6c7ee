"""What `make docs` is made of, on pages of one's own."""

from pathlib import Path

import pytest
from PIL import Image
from vmf_docs import __main__ as command
from vmf_docs import tutorial
from vmf_docs.__main__ import PAGES
from vmf_docs.links import broken_links
from vmf_docs.pages import Page
from vmf_docs.reference import unit


def page(directory: Path, text: str, name: str = "page.md") -> Page:
    path = directory / name
    path.write_text(text, encoding="utf-8")
    return Page.read(path)


@pytest.mark.parametrize(
    ("link", "found"),
    [
        ("other.md", ""),
        ("other.md#a-b_c", ""),
        ("#here", ""),
        ("https://example.org/nothing", ""),
        ("none.md", "no such file"),
        ("other.md#there", "no such heading"),
        ("#there", "no such heading"),
        ("../../outside.md", "outside of the project"),
    ],
)
@pytest.mark.parametrize("form", ["[text]({})", "![picture]({})", "| a |\n| --- |\n| [text]({}) |"])
def test_links_are_checked(tmp_path, link, found, form):
    page(tmp_path, "# A: `b_c`\n", "other.md")
    lines = broken_links([page(tmp_path, f"# Here\n\n{form.format(link)}\n")], tmp_path)
    assert len(lines) == bool(found)
    assert all(found in line and "page.md:" in line for line in lines)


@pytest.mark.parametrize(
    ("formula", "found"),
    [
        (r"\frac{a}{b}", ""),
        (r"\left( a", "ExtraLeftOrMissingRight"),
        ("a_", "MissingSuperScriptOrSubscript"),
        (r"\nosuch x", r"\nosuch is not known"),
    ],
)
@pytest.mark.parametrize("form", ["text ${}$", "$$\n{}\n$$"])
def test_formulas_are_checked(tmp_path, formula, found, form):
    lines = page(tmp_path, "# A\n\n" + form.format(formula) + "\n").wrong_formulas
    assert len(lines) == bool(found)
    assert all(found in line and "page.md:3: " in line for line in lines)


def test_nothing_is_written_where_a_page_is_wrong(tmp_path, monkeypatch, capsys):
    pages = {name: tmp_path / path.name for name, path in PAGES.items()}
    for path in pages.values():
        path.write_text("# A\n", encoding="utf-8")
    pages["method"].write_text("# A\n\n$a_$\n", encoding="utf-8")
    monkeypatch.setattr(command, "PAGES", pages)
    assert command.main(["--no-run"]) == 1
    assert "method.md:3: formula 'a_'" in capsys.readouterr().err
    assert pages["reference"].read_text(encoding="utf-8") == "# A\n"


@pytest.mark.parametrize(
    ("argument", "code", "said"),
    [
        ("--help", 0, "usage: python -m vmf_docs [-h] [--no-run]"),
        ("--norun", 2, "unrecognized arguments: --norun"),
        ("--no-ru", 2, "unrecognized arguments: --no-ru"),
        ("tutorial", 2, "unrecognized arguments: tutorial"),
    ],
)
def test_what_is_no_option_is_refused_before_anything_is_done(argument, code, said, monkeypatch, capsys):
    monkeypatch.setattr(command, "PAGES", {})
    for part, name in ((command.tutorial, "run"), (command.site, "build"), (command.shutil, "rmtree")):
        monkeypatch.setattr(part, name, lambda *_, **__: pytest.fail("something was done"))
    with pytest.raises(SystemExit) as ended:
        command.main([argument])
    assert ended.value.code == code
    output = capsys.readouterr()
    assert said in (output.err if code else output.out)


def test_headings_of_one_name_are_numbered(tmp_path):
    assert page(tmp_path, "# A\n\n## A\n").anchors == {"a", "a-1"}


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("pixel_px", "px"),
        ("travel_m", "m"),
        ("drift_rad_per_sqrt_m", "rad/√m"),
        ("gains_per_s", "1/s"),
        ("frames", ""),
        ("m", ""),
    ],
)
def test_units_are_read_off_keys(key, expected):
    assert unit(key) == expected


TUTORIAL = """# T

```yaml a.yaml
x: 1
```

```sh run
cat a.yaml
echo "$PWD/runs/a/0123456789-20250101T000000.000000Z"
echo "note: kept" >&2
echo "dropped" >&2
```

```text
old
```

```sh run needs=absent.mcap
false
```

```text
as it was
```
"""


def run(at: Page, work: Path) -> tuple[str, list[str]]:
    work.mkdir(exist_ok=True)
    said: list[str] = []
    return tutorial.run(at, work, Path("/nonexistent"), said.append), said


def test_output_goes_into_the_page_and_what_lacks_a_file_stays(tmp_path):
    text, said = run(page(tmp_path, TUTORIAL), tmp_path / "work")
    assert text == TUTORIAL.replace("old", "x: 1\nruns/a/latest\nnote: kept")
    assert "there is no absent.mcap" in said[-1]
    again, _ = run(page(tmp_path, text), tmp_path / "work")
    assert again == text


def test_another_exit_code_is_an_error(tmp_path):
    with pytest.raises(tutorial.TutorialError, match=r"page.md:1: exit code 1, expected 3"):
        run(page(tmp_path, "```sh run exit=3\nfalse\n```\n"), tmp_path / "work")
    run(page(tmp_path, "```sh run exit=1\nfalse\n```\n"), tmp_path / "work")


def test_figures_become_the_pictures_that_follow(tmp_path):
    (tmp_path / "work").mkdir()
    for name, color in (("a", "red"), ("b", "blue")):
        Image.new("RGB", (2800, 100), color).save(tmp_path / "work" / f"{name}.png")
    text = "![](before.png)\n\n```sh run shows=a.png,b.png\ntrue\n```\n\n![](x/1.png)\n\n![](x/2.png)\n"
    run(page(tmp_path, text), tmp_path / "work")
    with Image.open(tmp_path / "x" / "1.png") as first, Image.open(tmp_path / "x" / "2.png") as second:
        assert first.size == second.size == (1400, 50)
        assert (first.convert("RGB").getpixel((0, 0)), second.convert("RGB").getpixel((0, 0))) == (
            (255, 0, 0),
            (0, 0, 255),
        )
    assert not (tmp_path / "before.png").exists()


def test_too_few_pictures_are_an_error(tmp_path):
    with pytest.raises(tutorial.TutorialError, match="fewer than 1 pictures"):
        run(page(tmp_path, "```sh run shows=a.png\ntrue\n```\n"), tmp_path / "work")
