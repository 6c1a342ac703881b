"""``python -m stillpoint.scripts.pages.settings_pages``: write the tables of settings in docs/ from the code.

An estimator of the table without a section on its page gets one, from its module's docstring, to be put in order.
"""

import re
import sys
from pathlib import Path

from stillpoint.datasets.settings import Settings, describe
from stillpoint.filters import ESTIMATORS
from stillpoint.filters.front import guard, heading_source
from stillpoint.filters.table import find_estimator
from stillpoint.smoother import METHODS, ROLL_METHODS

PAGES = (Path("docs/estimators.md"), Path("docs/method.md"), Path("docs/roll.md"), Path("docs/streaming.md"))
BETWEEN_MARKS = re.compile(r"(<!-- (estimators|settings) ?([\w-]*) -->\n).*?(<!-- end -->)", re.DOTALL)
TABLE_OF_ALL = "<!-- estimators -->"
LAST_SECTIONS = "## How accurate they are"  # new ones come before


def main(*pages: Path) -> None:
    """Rewrite the text between the marks of these pages, by default of all pages that have marks."""
    for page in pages or PAGES:
        page.write_text(refresh_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


def refresh_tables(text: str) -> str:
    """Return the text of a page with new tables, and on the page of estimators a section for each."""

    def make_table(match: re.Match[str]) -> str:
        made = _list_estimators() if match[2] == "estimators" else _list_settings(_find_defaults(match[3]))
        return f"{match[1]}{made}{match[4]}"

    if TABLE_OF_ALL in text:
        new = "".join(_make_section(name) for name in ESTIMATORS if f"\n## {name}\n" not in text)
        text = text.replace(LAST_SECTIONS, new + LAST_SECTIONS)
    return BETWEEN_MARKS.sub(make_table, text)


def _list_estimators() -> str:
    lines = ["| name | what | sees the future |", "|---|---|---|"]
    for name, entry in ESTIMATORS.items():
        peer = "peer: " if entry.is_peer else ""
        lines.append(f"| [`{name}`](#{name}) | {peer}{entry.summary} | {'yes' if entry.offline else 'no'} |")
    return "\n".join(lines) + "\n"


def _make_section(name: str) -> str:
    """Return the module docstring of an estimator as Markdown, and a place for its settings."""
    said = sys.modules[find_estimator(name).params.__module__].__doc__ or ""
    said = re.sub(r":\w+:`([^`]*)`", r"`\1`", said.replace("``", "`"))
    return f"## {name}\n\n{re.sub(r' ?::$', ':', said, flags=re.MULTILINE)}\n<!-- settings {name} -->\n<!-- end -->\n\n"


def _find_defaults(name: str) -> Settings:
    """Return the default settings of a reference method, the heading source, the sensors' ranges or an estimator."""
    if name == "gps-course":
        return heading_source.Params()
    if name == "range":
        return guard.Ranges()
    methods = METHODS | ROLL_METHODS
    return methods[name].defaults if name in methods else find_estimator(name).params()


def _list_settings(settings: Settings) -> str:
    lines = ["| setting | default | range | meaning |", "|---|---|---|---|"]
    for one in describe(settings):
        lines.append(f"| `{one.name}` | {one.default} | {one.allowed} | {one.meaning} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
