"""Markdown extension: LaTeX between dollars becomes MathML at build time, so pages need neither script nor network.

`$x$` is inline. A block of `$$`, a label, lines of LaTeX and `$$` is a numbered equation; its label is its anchor.
"""

from __future__ import annotations

import html
import re
import xml.etree.ElementTree as etree

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.blockprocessors import BlockProcessor
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor

_BLOCK = re.compile(r"\$\$ *(?P<label>[\w:-]*)\n(?P<latex>.+)\n\$\$\s*", re.DOTALL)


class _Inline(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # type: ignore[override]
        return self.md.htmlStash.store(convert(m.group(1))), m.start(0), m.end(0)


class _Equation(BlockProcessor):
    def test(self, parent: etree.Element, block: str) -> bool:
        return block.startswith("$$")

    def run(self, parent: etree.Element, blocks: list[str]) -> None:
        block = blocks.pop(0)
        found = _BLOCK.fullmatch(block)
        if found is None:
            raise ValueError(f"equation without its end, or with an empty line in it: {block[:60]!r}")
        label = html.escape(found["label"])
        name = f'<a class="equation-label" href="#{label}">{label}</a>' if label else ""
        mathml = convert(found["latex"], display="block")
        text = (
            f'<div class="equation" id="{label}">{mathml}{name}</div>'
            if label
            else f'<div class="equation">{mathml}</div>'
        )
        etree.SubElement(parent, "p").text = self.parser.md.htmlStash.store(text)


class MathML(Extension):
    """Registers both processors: inline before escapes and emphasis, but after code."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register with a `Markdown` instance."""
        md.inlinePatterns.register(_Inline(r"(?<![\\$])\$([^$\n]+?)\$", md), "mathml", 185)
        md.parser.blockprocessors.register(_Equation(md.parser), "equation", 175)


def makeExtension(**options: object) -> MathML:
    """Entry point of Python-Markdown."""
    return MathML(**options)
