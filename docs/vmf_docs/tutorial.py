"""The commands of a page, run as they stand there; what they print goes back into the page.

A fenced block `yaml NAME.yaml` is written to that file. A block `sh run` is run; the block `text` after it
is what it prints. Words behind `run` say more: `exit=3` the exit code expected, `needs=PATH` a file without
which the block is skipped, `shows=PATH,…` the figures that the next pictures of the page are copies of.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from io import BytesIO
from itertools import zip_longest
from pathlib import Path

from PIL import Image

from vmf_docs.links import file_and_anchor
from vmf_docs.pages import Block, Page

# Run directories are named by hash and time; the link beside them always is the last one.
_STAMP = re.compile(r"/[0-9a-f]{10}-\d{8}T[\d.]+Z")
_WIDEST_PX, _COLOURS = 1400, 128


class TutorialError(Exception):
    """A command did not end as the page says."""


def run(page: Page, work: Path, program: Path, say: Callable[[str], None]) -> str:
    """Run the page's commands in the directory `work` and return the page with what they print.

    Parameters
    ----------
    page : the page; its pictures are replaced on disk.
    work : an empty directory.
    program : the directory of the `vmf` that is run.
    say : called with what was skipped and why.

    Raises
    ------
    TutorialError : a command ended with another exit code.
    """
    lines = page.text.splitlines()
    blocks = page.blocks
    printed: dict[Block, str] = {}
    for block, after in zip_longest(blocks, blocks[1:]):
        if block.words[:1] == ("yaml",) and len(block.words) == 2:
            (work / block.words[1]).write_text(block.text, encoding="utf-8")
        if block.words[:2] != ("sh", "run"):
            continue
        options = dict(word.split("=", 1) for word in block.words[2:])
        needed = options.get("needs")
        if needed is not None and not (work / needed).exists():
            say(f"{page.path}:{block.first + 1}: skipped, there is no {needed}")
            continue
        say(f"{page.path}:{block.first + 1}: {block.text.splitlines()[0]}")
        text = _output(block, page, work, program, int(options.get("exit", 0)))
        if after is not None and after.words == ("text",):
            printed[after] = text
        sources = options["shows"].split(",") if "shows" in options else []
        for source, picture in zip(sources, _pictures_after(page, block, len(sources)), strict=True):
            _copy_picture(work / source, picture)
    for block, text in reversed(printed.items()):
        lines[block.first + 1 : block.last - 1] = text.splitlines()
    return "\n".join(lines) + "\n"


def _output(block: Block, page: Page, work: Path, program: Path, expected: int) -> str:
    environment = {**os.environ, "PATH": f"{program}{os.pathsep}{os.environ['PATH']}"}
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
    )
    if ended.returncode != expected:
        place = f"{page.path}:{block.first + 1}"
        raise TutorialError(f"{place}: exit code {ended.returncode}, expected {expected}\n{ended.stderr}")
    said = [line for line in ended.stderr.splitlines() if line.startswith(("note: ", "lost: "))]
    text = "\n".join([*ended.stdout.splitlines(), *said])
    return "\n".join(
        line.rstrip() for line in _STAMP.sub("/latest", text.replace(f"{work}{os.sep}", "")).splitlines()
    )


def _pictures_after(page: Page, block: Block, n: int) -> list[Path]:
    pictures = [t for t in page.targets if t.is_picture and t.line > block.last][:n]
    if len(pictures) < n:
        raise TutorialError(f"{page.path}:{block.first + 1}: fewer than {n} pictures follow")
    return [file_and_anchor(page.path, picture.text)[0] for picture in pictures]


def _copy_picture(source: Path, to: Path) -> None:
    """Copy a figure, smaller: few colours are enough for lines and letters."""
    with Image.open(source) as image:
        picture = image.convert("RGB")
    if picture.width > _WIDEST_PX:
        height = round(picture.height * _WIDEST_PX / picture.width)
        picture = picture.resize((_WIDEST_PX, height), Image.Resampling.LANCZOS)
    buffer = BytesIO()
    picture.quantize(_COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        buffer, "png", optimize=True
    )
    to.parent.mkdir(exist_ok=True)
    to.write_bytes(buffer.getvalue())
