"""``python -m stillpoint.scripts.pages.settings_pages``: write the tables of settings in docs/ from the code.

An estimator of the table without a section on the page of its family gets one, from its module's docstring, to be put
in order.
"""

import re
import sys
from pathlib import Path

from stillpoint.datasets.settings import Settings, describe
from stillpoint.filters import ESTIMATORS
from stillpoint.filters.c.export import EXPORTED
from stillpoint.filters.front import guard, heading_source
from stillpoint.filters.table import Estimator, SpinEstimator, find_estimator
from stillpoint.scripts.program import run_program
from stillpoint.smoother import METHODS, SPIN_METHODS

_PEERS = "peers"  # the family of other packages' estimators; those of ours have the names of their folders
FAMILIES = ("complementary", "kalman", _PEERS, "spin")
_PAGES = (
    Path("docs/estimators.md"),
    *(Path(f"docs/estimators-{family}.md") for family in FAMILIES),
    Path("docs/reference-settings.md"),
    Path("docs/roll.md"),
    Path("docs/streaming.md"),
)
_BETWEEN_MARKS = re.compile(r"(<!-- (estimators|settings) ?([\w-]*) -->\n).*?(<!-- end -->)", re.DOTALL)
_NEW_SECTIONS = re.compile(r"<!-- new sections of (\w+) -->")  # they come before


def main(*pages: Path) -> None:
    """Rewrite the text between the marks of these pages, by default of all pages that have marks."""
    for page in pages or _PAGES:
        page.write_text(refresh_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


def refresh_tables(text: str) -> str:
    """Return the text of a page with new tables, and on the page of a family a section for each estimator."""

    def make_table(match: re.Match[str]) -> str:
        made = _list_estimators() if match[2] == "estimators" else _list_settings(_find_defaults(match[3]))
        return f"{match[1]}{made}{match[4]}"

    family = _NEW_SECTIONS.search(text)
    if family is not None:
        names = [name for name in ESTIMATORS if find_family(name) == family[1] and f"\n## {name}\n" not in text]
        text = text.replace(family[0], "".join(map(_make_section, names)) + family[0])
    return _BETWEEN_MARKS.sub(make_table, text)


def find_family(name: str) -> str:
    """Return the family of an estimator: its page is ``docs/estimators-FAMILY.md``."""
    if ESTIMATORS[name].is_peer:
        return _PEERS
    return find_estimator(name).params.__module__.split(".")[2]


def _list_estimators() -> str:
    """Return the table of all estimators in Markdown."""
    lines = ["| name | what | covariance | live | C |", "|---|---|---|---|---|"]
    for name, entry in ESTIMATORS.items():
        peer = "peer: " if entry.is_peer else ""
        states = isinstance(entry, SpinEstimator) or (isinstance(entry, Estimator) and entry.gives_cov)
        live = "no: sees the future" if entry.offline else "no" if entry.is_peer else "yes"
        answers = "yes" if states else "no", live, "yes" if name in EXPORTED else "no"
        page = f"estimators-{find_family(name)}.md"
        lines.append(f"| [`{name}`]({page}#{name}) | {peer}{entry.summary} | {' | '.join(answers)} |")
    return "\n".join(lines) + "\n"


def _make_section(name: str) -> str:
    """Return the module docstring of an estimator as Markdown, and a place for its settings."""
    text = sys.modules[find_estimator(name).params.__module__].__doc__ or ""
    text = re.sub(r":\w+:`([^`]*)`", r"`\1`", text.replace("``", "`"))
    return f"## {name}\n\n{re.sub(r' ?::$', ':', text, flags=re.MULTILINE)}\n<!-- settings {name} -->\n<!-- end -->\n\n"


def _find_defaults(name: str) -> Settings:
    """Return the default settings of a reference method, the heading source, the sensors' ranges or an estimator."""
    if name == "gps-course":
        return heading_source.Params()
    if name == "range":
        return guard.Ranges()
    methods = METHODS | SPIN_METHODS
    return methods[name].defaults if name in methods else find_estimator(name).params()


def _list_settings(settings: Settings) -> str:
    """Return the table of settings in Markdown."""
    lines = ["| setting | default | range | meaning |", "|---|---|---|---|"]
    for one in describe(settings):
        lines.append(f"| `{one.name}` | {one.default} | {one.allowed} | {one.meaning} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run_program(main)
