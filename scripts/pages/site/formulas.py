"""Formulas of the documentation site as MathML, which browsers draw without a script or a font from elsewhere.

An extension of Python-Markdown, named in zensical.toml. It takes formulas as GitHub does: ``$…$`` within a line, and
fences of the kind ``math``. Needs the package latex2mathml of the extra docs.
"""

import re
from typing import Any
from xml.etree import ElementTree

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from markdown.preprocessors import Preprocessor

FENCE = re.compile(r"^```math\n(.*?)\n```$", re.MULTILINE | re.DOTALL)
# No space inside the signs and no letter or digit outside: "0.05 $ an hour, 0.02 $" is no formula.
INLINE = r"(?<![\\$\w])\$(?![\s$])([^$\n]+?)(?<![\s\\])\$(?![\w$])"
TAG = re.compile(r"\\tag\{([^}]*)\}")
# Among the priorities of Python-Markdown: after the whitespace is made regular (30), before fences (25) are taken.
_BEFORE_FENCES, _AFTER_CODE = 27, 185


class BadFormula(ValueError):
    """A formula with a command that the converter does not know."""


class _Blocks(Preprocessor):
    """Replaces fences by formulas that stand alone, with the number of the equation beside them."""

    def run(self, lines: list[str]) -> list[str]:
        return FENCE.sub(self._store_formula, "\n".join(lines)).split("\n")

    def _store_formula(self, match: re.Match[str]) -> str:
        """Return the placeholder of a displayed formula, converted to MathML with its number."""
        tags = TAG.findall(match[1])
        number = f'<span class="equation">({tags[0]})</span>' if tags else ""
        formula = convert_formula(TAG.sub("", match[1]), "block")
        return self.md.htmlStash.store(f'<div class="formula">{formula}{number}</div>')


class _Inline(InlineProcessor):
    """Replaces ``$…$`` by a formula within the line."""

    def handleMatch(  # type: ignore[override]  # noqa: N802
        self, m: re.Match[str], data: str
    ) -> tuple[str, int, int]:
        return self.md.htmlStash.store(convert_formula(m[1], "inline")), m.start(0), m.end(0)


class MathExtension(Extension):
    """Adds displayed and inline formulas to a Markdown converter."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802, D102
        md.preprocessors.register(_Blocks(md), "math-blocks", _BEFORE_FENCES)
        md.inlinePatterns.register(_Inline(INLINE, md), "math-inline", _AFTER_CODE)


def convert_formula(tex: str, display: str) -> str:
    """Return the MathML of a formula. Raises :class:`BadFormula` where a command would appear as text."""
    made = convert(tex.strip(), display=display)
    unknown = [part.text for part in ElementTree.fromstring(made).iter() if (part.text or "").startswith("\\")]
    if unknown:
        raise BadFormula(f"{tex}: {', '.join(map(str, unknown))} is not known; write it otherwise")
    return made


def makeExtension(**settings: Any) -> MathExtension:  # noqa: N802
    """Return the extension, under the name by which Python-Markdown asks for it."""
    return MathExtension(**settings)
