"""The README and the page of leaderboards quote the fidelity figures of one run."""

import json
import re
from pathlib import Path

import pytest

from stillpoint.datasets.errors import BadParameter
from stillpoint.scripts.pages.fidelity_page import main, make_sentence

ROOT = Path(__file__).parents[3]
JUDGE = {
    "judge": "graph",
    "tau_pooled": 0.9712,
    "tau_median": 0.98,
    "tau_worst": 0.9,
    "relative_rmse_median": 0.0171,
    "relative_rmse_p95": 0.2,
    "verdicts": 45,
    "wrong_verdicts": 0,
    "verdicts_other_half": 1000,
    "wrong_verdicts_other_half": 3,
    "bias": {"cf": 0.99, "ekf": 0.85},
}
FOUND = {"recordings": 12, "judges": [JUDGE], "rows": [{"estimator": "cf"}, {"estimator": "ekf"}]}


def test_one_run_is_written_into_readme_and_page(tmp_path):
    page, readme = tmp_path / "page.md", tmp_path / "README.md"
    page.write_text("a\n<!-- fidelity -->\nold\n<!-- end -->\nb\n<!-- fidelity bias -->\nold\n<!-- end -->\nc\n")
    readme.write_text("first\n<!-- fidelity -->\nold\n<!-- end -->\nlast\n")
    (tmp_path / "fidelity.json").write_text(json.dumps(FOUND))
    (tmp_path / "fidelity.png").write_bytes(b"a picture")
    main(tmp_path, page, readme, tmp_path / "figure.png")
    assert "| graph | 0.971 | 0.980 | 0.900 | 1.7 % | 20.0 % | 0 of 45 | 3 of 1000 (0.3 %) |" in page.read_text()
    assert "| `ekf` | `cf` |\n|---|---|\n| 0.85 | 0.99 |" in page.read_text()
    said = readme.read_text()
    assert said.startswith("first\n")
    assert said.endswith("last\n")
    assert "two estimators" in said
    assert "**none of 45 verdicts is contradicted" in said
    assert (tmp_path / "figure.png").read_bytes() == b"a picture"


def test_a_run_without_our_judge_is_refused():
    with pytest.raises(BadParameter, match="graph is not among the judges"):
        make_sentence({**FOUND, "judges": []})


def test_first_page_and_table_are_of_one_run():
    """The sentence of the README quotes the row of the graph."""
    row = re.search(
        r"\| graph \| ([\d.]+) .*?\| ([\d.]+) % .*? of (\d+) \|", (ROOT / "docs/leaderboard.md").read_text()
    )
    said = re.search(r"<!-- fidelity -->\n(.*?)<!-- end -->", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    for figure in row.groups():
        assert figure in said
