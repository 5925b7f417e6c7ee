"""A page of Markdown: its headings, links, pictures and fenced blocks, read by one parser for all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

from latex2mathml.converter import convert
from markdown_it import MarkdownIt
from markdown_it.token import Token
from mdit_py_plugins.anchors import anchors_plugin
from mdit_py_plugins.dollarmath import dollarmath_plugin
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_by_name
from pygments.util import ClassNotFound

_DEEPEST = 4
_PRIMED = re.compile(r"<msup><mi>(\w)</mi><mi>&#x02032;</mi></msup>")


@dataclass(frozen=True)
class Target:
    """What a link or a picture points to, and the line (from 1) of the paragraph it stands in."""

    text: str
    line: int
    is_picture: bool


@dataclass(frozen=True)
class Block:
    """A fenced block: the words after its fence, its text, and its lines `[first, last)` with both fences."""

    words: tuple[str, ...]
    text: str
    first: int
    last: int


@dataclass(frozen=True)
class Page:
    """A page as it stands on disk."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> Page:
        """Return the page in a file."""
        return cls(path, path.read_text(encoding="utf-8"))

    @cached_property
    def tokens(self) -> list[Token]:
        """The parsed page."""
        return _parser().parse(self.text)

    @property
    def title(self) -> str:
        """The first heading, without its markup."""
        tokens = self.tokens
        for token, inline in pairwise(tokens):
            if token.type == "heading_open":
                return "".join(child.content for child in inline.children or ())
        return self.path.stem

    @cached_property
    def anchors(self) -> frozenset[str]:
        """What `#…` may follow the page's name: the headings, slugged as GitHub does."""
        return frozenset(
            str(t.attrs["id"]) for t in self.tokens if t.type == "heading_open" and "id" in t.attrs
        )

    @property
    def targets(self) -> list[Target]:
        """All links and pictures."""
        return [
            Target(
                str(child.attrs["href" if child.type == "link_open" else "src"]), line, child.type == "image"
            )
            for line, child in _inline(self.tokens)
            if child.type in ("link_open", "image")
        ]

    @property
    def wrong_formulas(self) -> list[str]:
        """One line for each formula that cannot be set."""
        places = [(t.map[0] + 1, t) for t in self.tokens if t.type == "math_block" and t.map]
        places += [(line, t) for line, t in _inline(self.tokens) if t.type == "math_inline"]
        found = []
        for line, token in places:
            why = _objection(token.content)
            if why is not None:
                found.append(f"{self.path}:{line}: formula {token.content.strip()!r} cannot be set: {why}")
        return found

    @property
    def blocks(self) -> list[Block]:
        """All fenced blocks."""
        return [
            Block(tuple(token.info.split()), token.content, *token.map)
            for token in self.tokens
            if token.type == "fence" and token.map is not None
        ]

    def html(self, rewritten: dict[str, str]) -> str:
        """Return the page's body, each link and picture in `rewritten` replaced."""
        parser = _parser()
        tokens = parser.parse(self.text)
        for _, child in _inline(tokens):
            for key in ("href", "src"):
                if key in child.attrs:
                    child.attrs[key] = rewritten.get(str(child.attrs[key]), child.attrs[key])
        body = str(parser.renderer.render(tokens, parser.options, {}))
        # Wide tables scroll by themselves, not the page.
        return re.sub(r"<table>.*?</table>", r'<div class="wide">\g<0></div>', body, flags=re.DOTALL)


def _inline(tokens: list[Token]) -> Iterator[tuple[int, Token]]:
    for token in tokens:
        line = token.map[0] + 1 if token.map else 0
        for child in token.children or ():
            yield line, child


def _parser() -> MarkdownIt:
    parser = MarkdownIt("commonmark", {"html": False, "highlight": _highlighted}).enable("table")
    parser.use(anchors_plugin, max_level=_DEEPEST)
    parser.use(dollarmath_plugin, renderer=_math, allow_digits=False)
    return parser


def _objection(formula: str) -> str | None:
    """Return why a formula cannot be set, None if it can."""
    try:
        mathml = str(convert(formula))
    except Exception as error:  # the converter's own have no base in common
        return type(error).__name__.removesuffix("Error")
    unknown = re.search(r"\\\w+", mathml)
    return f"{unknown[0]} is not known" if unknown else None


def _math(text: str, options: dict[str, bool]) -> str:
    mathml = str(convert(text, display="block" if options["display_mode"] else "inline"))
    # Raised twice, by the font and by the exponent's place, where there is no font for mathematics.
    return _PRIMED.sub(r'<mi class="prime">\1′</mi>', mathml)


def _highlighted(code: str, language: str, _: str) -> str:
    try:
        lexer = get_lexer_by_name(language)
    except ClassNotFound:
        return ""
    return str(highlight(code, lexer, HtmlFormatter(nowrap=True)))
