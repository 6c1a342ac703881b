"""The promises of the first pages that a machine can keep: code runs, the verbs are all there, links lead somewhere."""

import re
from pathlib import Path

import pytest

from stillpoint.scripts.main import VERBS

ROOT = Path(__file__).parents[2]
INDEX = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.slow
def test_the_python_of_the_first_page_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys) -> None:
    """Figures may move in their last digit with numpy and BLAS; the words and the order may not."""
    code, printed = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", INDEX, re.DOTALL).groups()
    assert len(code.splitlines()) < 15
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "index.md", "exec"), {})
    said = capsys.readouterr().out
    numbers = re.compile(r"\d+\.\d")
    assert numbers.sub("#", said) == numbers.sub("#", printed)
    found, written = ([float(x) for x in numbers.findall(text)] for text in (said, printed))
    assert found == pytest.approx(written, abs=0.15)
    assert (tmp_path / "run7.reference.mcap").is_file()


def test_the_table_of_commands_has_every_verb() -> None:
    rows = re.search(r"## The commands\n(.*?)\n\n\[Commands", INDEX, re.DOTALL)[1]
    firsts = " ".join(line.split(" | ")[0] for line in rows.splitlines())
    assert set(VERBS) <= set(re.findall(r"[a-z]+(?:-[a-z]+)*", firsts))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_to_a_file_leads_to_one(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in target:
            file, _, anchor = target.partition("#")
            there = (page.parent / file) if file else page
            assert there.exists(), f"{page.name}: {target}"
            if anchor:
                titles = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE)
                anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
                assert anchor in anchors, f"{page.name}: {target}"
