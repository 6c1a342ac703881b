"""``python -m stillpoint.scripts.pages.fidelity_page OUT``: write how well judges replace truth into README and docs.

OUT is the folder of ``stillpoint validate --fidelity``, which holds ``fidelity.json`` and ``fidelity.png``.
"""

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.program import run_program

_PAGE = Path("docs/leaderboard.md")
_README = Path("README.md")
_FIGURE = Path("docs/figures/fidelity.png")
_OURS = "graph"
_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def main(out: Path, page: Path = _PAGE, readme: Path = _README, figure: Path = _FIGURE) -> None:
    """Rewrite the tables of the page, the sentence of the README, and the figure."""
    found = json.loads((out / "fidelity.json").read_text(encoding="utf-8"))
    _replace(page, "fidelity", make_table(found))
    _replace(page, "fidelity bias", _make_bias_table(found))
    _replace(readme, "fidelity", make_sentence(found))
    shutil.copyfile(out / "fidelity.png", figure)


def make_table(found: Mapping[str, Any]) -> str:
    """Return the names of the estimators, and a row for each judge."""
    names = ", ".join(f"`{name}`" for name in dict.fromkeys(row["estimator"] for row in found["rows"]))
    lines = [
        f"Estimators: {names}.",
        "",
        "| judge | tau pooled | median | worst | RMSE off, median | 95 % | wrong | on the other half |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for judge in found["judges"]:
        half = f"{judge['wrong_verdicts_other_half']} of {judge['verdicts_other_half']}"
        share = judge["wrong_verdicts_other_half"] / max(judge["verdicts_other_half"], 1)
        cells = [
            judge["judge"],
            *(f"{judge[name]:.3f}" for name in ("tau_pooled", "tau_median", "tau_worst")),
            *(_format_share(judge[name]) for name in ("relative_rmse_median", "relative_rmse_p95")),
            f"{judge['wrong_verdicts']} of {judge['verdicts']}",
            f"{half} ({_format_share(share)})",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _make_bias_table(found: Mapping[str, Any]) -> str:
    """Return the bias of our judge for each estimator, the smallest first."""
    bias = sorted(_find_ours(found)["bias"].items(), key=lambda item: item[1])
    names, values = [f"`{name}`" for name, _ in bias], [f"{value:.2f}" for _, value in bias]
    return f"| {' | '.join(names)} |\n{'|---' * len(names)}|\n| {' | '.join(values)} |\n"


def make_sentence(found: Mapping[str, Any]) -> str:
    """Return what the README says about our judge."""
    ours = _find_ours(found)
    count = _format_count(len({row["estimator"] for row in found["rows"]}))
    wrong = ours["wrong_verdicts"]
    verdicts = "none" if wrong == 0 else str(wrong)
    other = ours["wrong_verdicts_other_half"] / max(ours["verdicts_other_half"], 1)
    share = _format_share(ours["relative_rmse_median"])
    told = f"**{verdicts} of {ours['verdicts']} verdicts is contradicted by the truth**"
    lines = [
        f"On {found['recordings']} recordings with optical truth (BROAD), {count} estimators were ranked by",
        f"the optical truth and by our reference: Kendall's τ is {ours['tau_pooled']:.3f}, RMSE differs by {share}",
        f"(median), and {told} ({_format_share(other)} with the truth of the other half).",
    ]
    return "\n".join(lines) + "\n"


def _find_ours(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the figures of the graph; raises :class:`BadParameter` when it was no judge."""
    for judge in found["judges"]:
        if judge["judge"] == _OURS:
            ours: Mapping[str, Any] = judge
            return ours
    raise BadParameter(f"fidelity.json: {_OURS} is not among the judges; leave out --method")


def _format_count(number: int) -> str:
    return _SMALL[number] if number < len(_SMALL) else str(number)


def _format_share(share: float) -> str:
    return f"{share:.1%}".replace("%", " %")


def _replace(page: Path, name: str, made: str) -> None:
    """Write a text between the marks of a page; raises :class:`BadParameter` when they are not there."""
    text = page.read_text(encoding="utf-8")
    marks = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not marks.search(text):
        raise BadParameter(f"{page}: has no marks <!-- {name} --> and <!-- end -->")
    page.write_text(marks.sub(lambda match: f"{match[1]}{made}{match[2]}", text), encoding="utf-8")


if __name__ == "__main__":
    run_program(main)
