"""Give the API pages the comments of fields as their docstrings, and show Sphinx roles as code.

Two extensions, both named in zensical.toml: one of griffe, which reads the package for mkdocstrings, and one of
Python-Markdown.
"""

import ast
import re
import tokenize
from functools import cache
from pathlib import Path
from typing import Any

from griffe import Attribute, Docstring, Extension
from markdown import Extension as MarkdownExtension
from markdown import Markdown
from markdown.preprocessors import Preprocessor

_ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):`(~?)([^`]+)`")
_AFTER_WHITESPACE = 28  # among the priorities of Python-Markdown: after the whitespace is made regular (30)


class FieldComments(Extension):
    """Takes the comment behind a field of a class as its docstring: it has the field's shape, unit and meaning."""

    def on_attribute_instance(self, *, node: Any, attr: Attribute, **kwargs: Any) -> None:
        """Give a field its comment, where it has no docstring."""
        in_class = isinstance(node, ast.AnnAssign) and attr.parent is not None and attr.parent.is_class
        if in_class and attr.docstring is None and isinstance(attr.filepath, Path):
            comment = _list_comments(attr.filepath).get(node.end_lineno)
            if comment:
                attr.docstring = Docstring(comment, lineno=node.lineno, parent=attr)


@cache
def _list_comments(file: Path) -> dict[int, str]:
    """Return the comments of a module by line; lines that hold a comment alone continue the one above."""
    found: dict[int, str] = {}
    begun = last = 0
    with tokenize.open(file) as source:
        for token in tokenize.generate_tokens(source.readline):
            if token.type != tokenize.COMMENT:
                continue
            line, text = token.start[0], token.string.lstrip("# ").strip()
            alone = token.line.lstrip().startswith("#")
            if alone and last == line - 1 and begun:
                found[begun] += f" {text}"
            elif not alone:
                found[line], begun = text, line
            last = line
    return found


class _Roles(Preprocessor):
    """Replaces ``:class:`~a.b.C` `` by the name in code: mkdocstrings reads Markdown, where a role has no meaning."""

    def run(self, lines: list[str]) -> list[str]:
        return [_ROLE.sub(_name_target, line) for line in lines]


def _name_target(match: re.Match[str]) -> str:
    """Return what the API pages show for a role of Sphinx."""
    short, target = match.groups()
    return f"`{target.rpartition('.')[2] if short else target}`"


class RoleExtension(MarkdownExtension):
    """Adds the roles to a Markdown converter."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802, D102
        md.preprocessors.register(_Roles(md), "sphinx-roles", _AFTER_WHITESPACE)


def makeExtension(**settings: Any) -> RoleExtension:  # noqa: N802
    """Return the extension, under the name by which Python-Markdown asks for it."""
    return RoleExtension(**settings)
