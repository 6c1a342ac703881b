"""Write docs/commands.md, every command with its options: ``python -m stillpoint.scripts.pages.site.commands_page``.

``make docs`` runs it first, so that the site says what ``stillpoint VERB --help`` says.
"""

import re
from pathlib import Path

from stillpoint.scripts.main import app
from stillpoint.scripts.program import run_program

PAGE = Path(__file__).parents[3] / "docs" / "commands.md"
_HEAD = """# Commands

Every command with its arguments and options, as `stillpoint VERB --help` prints them. Every command also takes
`--debug` (show the traceback of an error) and `--large` (read inputs above the size limits). A mistake is one line
with exit code 2. Made by `python -m stillpoint.scripts.pages.site.commands_page`.
"""
# What the generator writes before the list of commands: a title, the usage and a table of contents.
_BEFORE_LIST = re.compile(r"\A.*?(?=\*\*Commands\*\*:)", re.DOTALL)


def main(page: Path = PAGE) -> None:
    """Write the page."""
    page.write_text(make_page(), encoding="utf-8")


def make_page() -> str:
    """Return the page: a list of the commands, then a section for each."""
    made = app().generate_docs(output_format="markdown", recursive=True)
    found, replaced = _BEFORE_LIST.subn("", made, count=1)
    if not replaced:
        raise ValueError("the generated help has no list of commands; look at what cyclopts writes")
    lines = [line.rstrip() for line in found.splitlines()]
    return _HEAD + "\n" + "\n".join(lines).strip() + "\n"


if __name__ == "__main__":
    run_program(main)
