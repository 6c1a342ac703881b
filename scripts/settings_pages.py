"""``python -m stillpoint.scripts.settings_pages``: make the tables in docs/ from the settings in the code."""

import re
import sys
from pathlib import Path

from stillpoint.datasets.settings import Settings, describe
from stillpoint.filters import ESTIMATORS
from stillpoint.filters.table import find
from stillpoint.smoother import METHODS, ROLL_METHODS

PAGES = (Path("docs/estimators.md"), Path("docs/method.md"))
BETWEEN_MARKS = re.compile(r"(<!-- (estimators|settings) ?([\w-]*) -->\n).*?(<!-- end -->)", re.DOTALL)


def main(*pages: Path) -> None:
    """Rewrite what stands between the marks of these pages, by default of all that have some."""
    for page in pages or PAGES:
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")


def refreshed(text: str) -> str:
    """A page's text with every generated table made anew."""

    def table(match: re.Match[str]) -> str:
        made = _estimators() if match[2] == "estimators" else _settings(_defaults(match[3]))
        return f"{match[1]}{made}{match[4]}"

    return BETWEEN_MARKS.sub(table, text)


def _estimators() -> str:
    lines = ["| name | what | sees the future |", "|---|---|---|"]
    for name, entry in ESTIMATORS.items():
        peer = "peer: " if entry.is_peer else ""
        lines.append(f"| [`{name}`](#{name}) | {peer}{entry.summary} | {'yes' if entry.offline else 'no'} |")
    return "\n".join(lines) + "\n"


def _defaults(name: str) -> Settings:
    """Of a reference method or an estimator."""
    methods = METHODS | ROLL_METHODS
    return methods[name].defaults if name in methods else find(name).params()


def _settings(settings: Settings) -> str:
    lines = ["| setting | default | range | meaning |", "|---|---|---|---|"]
    for one in describe(settings):
        lines.append(f"| `{one.name}` | {one.default} | {one.allowed} | {one.meaning} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
