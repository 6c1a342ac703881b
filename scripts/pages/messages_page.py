"""``python -m stillpoint.scripts.pages.messages_page``: collect every message that a user can meet in docs/messages.md.

The page shows all of them side by side, so that they can be read, and mended, as a user would read them.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from stillpoint.scripts.program import run_program

_ROOT = Path(__file__).parents[2]
_FOLDERS = ("datasets", "filters", "smoother", "scoring", "studies", "scripts")
_ERRORS = ("BadSource", "BadParameter", "BadFile", "BadRecording", "Unobservable")
_PAGE = Path("docs/messages.md")
_HEAD = """# Messages

What the command line says where something is wrong, in one line after `stillpoint:` and with exit code 2.
Words in braces and `…` stand for names and numbers.
`python -m stillpoint.scripts.pages.messages_page` makes this page from the code.
"""


def main(page: Path = _PAGE) -> None:
    """Write the page."""
    page.write_text(make_page(), encoding="utf-8")


def make_page() -> str:
    """Return the page: a section per folder, a list of messages per file."""
    parts = [_HEAD]
    for folder in _FOLDERS:
        parts.append(f"\n## {folder}\n")
        for file in sorted((_ROOT / folder).rglob("*.py")):
            found = list(dict.fromkeys(find_messages(file)))
            if found:
                parts.append(f"\n`{file.relative_to(_ROOT)}`\n\n" + "".join(f"- {message}\n" for message in found))
    return "".join(parts)


def find_messages(file: Path) -> Iterator[str]:
    """Yield the texts of the errors that a file raises, with … for what is filled in."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        call = node.exc if isinstance(node, ast.Raise) else None
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in _ERRORS and call.args:
            text = " ".join(_show(call.args[0]).split())
            if any(letter.islower() for letter in re.sub(r"\{\w+\}", "", text)):
                yield text.replace("<", "&lt;").replace("|", "\\|")


def _show(node: ast.expr) -> str:
    """Return the text of a string expression."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_show(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _show(node.left) + _show(node.right)
    value = node.value if isinstance(node, ast.FormattedValue) else node
    if isinstance(value, ast.Attribute):
        return "{type}" if value.attr == "__name__" else f"{{{value.attr.strip('_')}}}"
    return f"{{{value.id.lstrip('_')}}}" if isinstance(value, ast.Name) else "…"


if __name__ == "__main__":
    run_program(main)
