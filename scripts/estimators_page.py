"""``python -m stillpoint.scripts.estimators_page``: bring the tables of docs/estimators.md up to date with the code."""

import re
import sys
from pathlib import Path

from stillpoint.filters import ESTIMATORS
from stillpoint.filters.parameters import describe
from stillpoint.filters.table import find

PAGE = Path("docs/estimators.md")
BETWEEN_MARKS = re.compile(r"(<!-- (table|parameters) ?([\w-]*) -->\n).*?(<!-- end -->)", re.DOTALL)


def main(page: Path = PAGE) -> None:
    """Rewrite what stands between the marks."""
    page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")


def refreshed(text: str) -> str:
    """The page's text with every generated table made anew."""

    def table(match: re.Match[str]) -> str:
        made = _overview() if match[2] == "table" else _parameters(match[3])
        return f"{match[1]}{made}{match[4]}"

    return BETWEEN_MARKS.sub(table, text)


def _overview() -> str:
    lines = ["| name | what | sees the future |", "|---|---|---|"]
    for name, entry in ESTIMATORS.items():
        peer = "peer: " if entry.is_peer else ""
        lines.append(f"| [`{name}`](#{name}) | {peer}{entry.summary} | {'yes' if entry.offline else 'no'} |")
    return "\n".join(lines) + "\n"


def _parameters(name: str) -> str:
    lines = ["| parameter | default | range | meaning |", "|---|---|---|---|"]
    for parameter, default, allowed, meaning in describe(find(name).params):
        lines.append(f"| `{parameter}` | {default} | {allowed} | {meaning} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
