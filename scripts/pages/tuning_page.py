"""``python -m stillpoint.scripts.pages.tuning_page FOLDER OUT [JOBS]``: tune ours and theirs, quote on others.

Recordings with truth are split by every second name of each source: half A is tuned on, half B is quoted. Two kinds of
input: corrected by the reference, of all recordings, and as recorded, of those whose magnetometer is calibrated. Trials
and results are kept in OUT, so that a second run only writes the tables.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.files.result_store import ResultStore
from stillpoint.filters import ESTIMATORS
from stillpoint.scripts.program import run_program
from stillpoint.scripts.shared.children import Outcome
from stillpoint.scripts.shared.flags import Whole, Workers
from stillpoint.scripts.shared.inputs import find_recordings
from stillpoint.scripts.shared.jobs import run_jobs
from stillpoint.scripts.shared.output import print_line, write_text
from stillpoint.studies.leaderboard import Leaderboard, Pair, Row, Summary, Table, leaderboard
from stillpoint.studies.leaderboard.board import Source
from stillpoint.studies.leaderboard.sources import survey_sources
from stillpoint.studies.tune import ParamRange, Sampler, Tuning, format_tuning, tune

_PAGE = Path("docs/estimator-accuracy.md")
_INPUTS = {"calibrated": "reference", "raw": "none"}


@dataclass(frozen=True)
class _Search:
    """The parameters of an estimator that are tuned, in which ranges, and how hard."""

    ranges: tuple[ParamRange, ...]
    trials: int
    sampler: Sampler = "tpe"
    seconds: float | None = None  # of motion; the filters of ahrs take 0.1 to 0.5 ms a sample


def _make_search(text: str, trials: int, sampler: Sampler = "tpe", seconds: float | None = None) -> _Search:
    return _Search(tuple(map(ParamRange.parse, text.split())), trials, sampler, seconds)


_KALMAN = "velocity_mps_rts=0.1:3:log field_noise_ut_rts=2:60:log"
SEARCHES: dict[str, _Search] = {
    "ekf": _make_search(_KALMAN, 30),
    "aekf": _make_search(_KALMAN, 30),
    "vqf": _make_search("tau_acc_s=0.5:10:log tau_mag_s=2:100:log", 30),
    "cf": _make_search("omega0_radps=0.01:2:log zeta=0.3:3", 30),
    "cf-fixed": _make_search("kp_per_s=0.02:2:log ki_per_s2=0.0001:0.1:log", 30),
    "kf-axis": _make_search("tilt_sd_rad=0.05:1.5:log heading_sd_rad=0.1:3:log", 30),
    "fusion": _make_search("gain_radps=0.02:2:log", 12),
    "madgwick": _make_search("gain_marg_radps=0.002:0.2:log", 8, "grid", 60.0),
    "mahony": _make_search("k_p_radps=0.02:3:log k_i_radps2=0.0001:0.5:log", 14, "tpe", 60.0),
    "ahrs-ekf": _make_search("accel_sd=0.1:100:log mag_sd=0.1:100:log", 14, "tpe", 60.0),
}


def main(folder: Path, out: Path, jobs: Whole = 1, page: Path = _PAGE, names: Sequence[str] = tuple(SEARCHES)) -> None:
    """Tune on half A, quote on half B, and rewrite the tables of the page."""
    files = find_recordings([folder])
    sources = [source for source in survey_sources(files, ResultStore(out / "sources")) if source.truth]

    def run(function: Callable[[Any], Any], items: Sequence[Any], what: str) -> list[Outcome[Any]]:
        return run_jobs(function, items, Workers(jobs), what)

    for kind in _INPUTS:  # a page without marks ends the command before an hour of computing, not after it
        _replace_table(page.read_text(encoding="utf-8"), kind, "")
    for kind, calibration in _INPUTS.items():
        usable = [s for s in sources if calibration != "none" or s.magnetometer == "calibrated"]
        half_a, half_b = split_halves(usable)
        tunings = {}
        for name in names:
            search = SEARCHES[name]
            tunings[name] = tune(
                half_a,
                name,
                search.ranges,
                out / kind,
                sampler=search.sampler,
                trials=search.trials,
                steps=search.trials,
                against="truth",
                calibration=calibration,
                seconds=search.seconds,
                workers=jobs,
                run_jobs=run,
            )
            write_text(out / kind / f"{name}-tuned.toml", format_tuning(tunings[name]))
            print_line(f"{kind}, {name}: {tunings[name].best.params}", flush=True)
        labels = [each for name in names for each in (name, f"{name}@{out / kind / name}-tuned.toml")]
        _, uncalibrated_b = split_halves([source for source in sources if source not in usable])
        boards = [
            leaderboard(
                quoted, labels, out / f"{where}-{kind}", against="truth", calibration=[calibration], run_jobs=run
            )
            for where, quoted in (("quoted", half_b), ("inclination", uncalibrated_b))
            if quoted
        ]
        text = _replace_table(page.read_text(encoding="utf-8"), kind, make_table(tunings, *boards))
        page.write_text(text, encoding="utf-8")


def split_halves(sources: Sequence[Source]) -> tuple[list[Path], list[Path]]:
    """Return half A and half B: every second recording of each source, by name."""
    halves: tuple[list[Path], list[Path]] = ([], [])
    ordered = sorted(sources, key=lambda source: (source.source, source.recording))
    for _, same in groupby(ordered, key=lambda source: source.source):
        for k, source in enumerate(same):
            halves[k % 2].append(Path(source.file))
    return halves


def make_table(tunings: Mapping[str, Tuning], board: Leaderboard, inclined: Leaderboard | None = None) -> str:
    """Return a row for each estimator: typical errors on both halves, the gain on half B, and the setting.

    ``inclined`` is a leaderboard of other recordings, on which the inclination alone says something.
    """
    (table,) = board.tables
    rows = {row.label: row for row in table.rows}
    headings = ["estimator", "A, defaults", "A, tuned", "B, defaults", "B, tuned", "tuned / defaults on B"]
    headings += ["raw phones, inclination: defaults", "tuned", "tuned / defaults"] if inclined else []
    headings += ["tuned", "trials"]
    lines = [f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for name in sorted(tunings, key=lambda each: _get_typical(rows[_get_tuned_label(each)])):
        tuning, label = tunings[name], _get_tuned_label(name)
        setting = ", ".join(f"`{param}` {value:.3g}" for param, value in tuning.best.params.items())
        stretch = tuning.settings["seconds"]
        trials = f"{len(tuning.trials)}, {tuning.settings['sampler']}" + (f", {stretch:.0f} s" if stretch else "")
        cells = [
            f"`{name}`" + (" (peer)" if ESTIMATORS[name].is_peer else ""),
            f"{tuning.defaults.typical_deg:.2f}",
            f"{tuning.best.typical_deg:.2f}",
            *_compare(table, name, label),
            *(() if inclined is None else _compare(inclined.tables[0], name, label)),
            setting,
            trials,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _get_tuned_label(name: str) -> str:
    return f"{name}@{name}-tuned"


def _get_typical(row: Row) -> float:
    return float("inf") if row.total_rmse_deg is None else row.total_rmse_deg.typical


def _compare(table: Table, name: str, label: str) -> list[str]:
    """Return the typical error of the defaults and of the tuned setting, and their ratio."""
    rows = {row.label: row for row in table.rows}
    found = []
    for row in (rows[name], rows[label]):
        summary: Summary | None = getattr(row, f"{table.ranked_by}_rmse_deg")
        low, high = (0.0, 0.0) if summary is None else summary.ci95
        found.append("–" if summary is None else f"{summary.typical:.2f} ({low:.2f}-{high:.2f})")
    return [*found, _format_gain(table.pairs, name, label)]


def _format_gain(pairs: Sequence[Pair], name: str, label: str) -> str:
    """Return the ratio of tuned over defaults with its interval, and the verdict of the leaderboard."""
    pair = next((pair for pair in pairs if {pair.a, pair.b} == {name, label}), None)
    if pair is None:
        return "–"
    turned = pair.a == name
    ratio, low, high = (1 / pair.ratio, 1 / pair.ci95[1], 1 / pair.ci95[0]) if turned else (pair.ratio, *pair.ci95)
    winner = {"a": pair.a, "b": pair.b, "undecided": ""}[pair.verdict]
    verdict = "undecided" if not winner else "better" if winner == label else "worse"
    return f"{ratio:.2f} ({low:.2f}-{high:.2f}), {verdict}"


def _replace_table(text: str, kind: str, table: str) -> str:
    """Return the page with the table of one kind of input between its marks; raises :class:`BadParameter`."""
    marks = re.compile(rf"(<!-- tuned {kind} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not marks.search(text):
        raise BadParameter(f"the page has no marks <!-- tuned {kind} --> and <!-- end -->")
    return marks.sub(lambda match: f"{match[1]}{table}{match[2]}", text)


if __name__ == "__main__":
    run_program(main)
