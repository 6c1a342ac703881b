"""Write the tables of docs/papers.md: ``python -m stillpoint.scripts.pages.site.papers_page FOLDER``.

FOLDER holds what the commands of TABLES wrote, ``stillpoint experiment … --json FOLDER/NAME.json``. A table of which a
file is missing stays as it is. Above each table the script prints its command and how far our figures may be off the
page before ``tests/scripts/pages/site/test_papers_page.py`` fails.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stillpoint.scripts.program import run_program
from stillpoint.studies.papers.auv.page import INPUTS
from stillpoint.studies.papers.auv.study import PRINTED_FIGURES, SEAS
from stillpoint.studies.papers.phone.parameters import PRINTED, SLOWER, find_frequencies_below_mean
from stillpoint.studies.papers.phone.study import (
    ACC,
    ACC_MA,
    ACC_MA_CENTRED,
    AXES,
    CF,
    CF_LITERAL,
    CF_SLOWER,
    EXPERIMENTS,
    KALMAN,
    PRINTED_KALMAN_GAIN,
)
from stillpoint.studies.papers.servo.study import PRINTED_DRIFT_DEG
from stillpoint.studies.papers.spin.study import (
    CONSTANT,
    EQUAL,
    METRICS,
    NOISES,
    OF_PAPER,
    VARIABLE,
    Scenario,
)

PAGE = Path(__file__).parents[3] / "docs" / "papers.md"
_BETWEEN_MARKS = re.compile(r"(<!-- run ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
SHARE_BAND = 0.1  # of a figure: seeds are fixed, so only other code or libraries move it
COUNT_BAND = 1  # of a count of trials
_Row = Mapping[str, Any]
_Rows = Sequence[_Row]
PHONE_METHODS = {1: (CF, CF_SLOWER, CF_LITERAL, ACC, ACC_MA, ACC_MA_CENTRED), 2: (CF, CF_SLOWER, CF_LITERAL, ACC)}
PHONE_METHODS[3] = PHONE_METHODS[2]
_SPIN_COLUMNS = ("angle, largest, deg", "angle, RMSE", "rate, largest, deg/s", "rate, RMSE")
_AUV_COLUMNS = {
    "roll_off_mean_deg": "roll off, mean, deg",
    "roll_off_var_deg2": "variance, deg²",
    "pitch_off_mean_deg": "pitch off, mean",
    "pitch_off_var_deg2": "variance",
    "below_roll_rmse_deg": "true roll error below, RMSE",
    "heading_after_deg": "heading error after 600 s",
    "heading_drift_deg": "its change",
}
_SERVO_ROWS = {
    "roll by the accelerometer": "acc",
    "roll by `kf-axis`": "kf",
    "heading, levelled by the accelerometer": "acc_heading",
    "heading by `kf-axis`": "kf_heading",
}
_TEN = 10  # trials of the paper


class Table(NamedTuple):
    """One table of the page."""

    make: Callable[..., list[str]]  # from the rows of each file
    files: tuple[str, ...]  # their names without the ending
    commands: tuple[str, ...]
    counts: bool = False  # whether some of its figures are counts of trials


def main(folder: Path, page: Path = PAGE) -> None:
    """Rewrite the tables of the page for which FOLDER holds the figures."""
    page.write_text(replace_tables(page.read_text(encoding="utf-8"), folder), encoding="utf-8")


def replace_tables(text: str, folder: Path) -> str:
    """Return the text of the page with new tables between its marks."""

    def write_table(match: re.Match[str]) -> str:
        """Return a table with its marks; the old one where a file with its figures is missing."""
        table = TABLES[match[2]]
        files = [folder / f"{name}.json" for name in table.files]
        if not all(file.is_file() for file in files):
            return match[0]
        lines = table.make(*(json.loads(file.read_text(encoding="utf-8"))["rows"] for file in files))
        return match[1] + "\n".join(["", _introduce(table), "", *lines, "", match[3]])

    return _BETWEEN_MARKS.sub(write_table, text)


def list_phone(*runs: _Rows) -> list[str]:
    """Return tables 2 to 4 of Elmi Aziz and Mohseni Araste beside ours: RMSE / largest error, means over the trials."""
    lines = _format_head("experiment", "method", *AXES)
    for scenario, rows in zip(EXPERIMENTS.values(), runs, strict=True):
        for method, printed in scenario.printed.items():
            pairs = [f"{printed[k]:.4g} / {printed[k + 1]:.4g}" for k in (0, 2, 4)]
            lines.append(_format_line(f"{scenario.number}, the paper", method, *pairs))
        for hand, kind in scenario.hands.items():
            for method in PHONE_METHODS[scenario.number]:
                some = _select(rows, hand=hand, method=method, against="benchmark")
                if some:
                    pairs = [
                        f"{_format_mean(some, f'{a}_rmse_deg')} / {_format_mean(some, f'{a}_maxae_deg')}" for a in AXES
                    ]
                    lines.append(_format_line(f"{scenario.number}, `{kind}`", method, *pairs))
    return lines


def list_long_run(rows: _Rows) -> list[str]:
    """Return errors and time of CF and the Kalman filters over two hours, and what the paper says of its own."""
    gain = PRINTED_KALMAN_GAIN
    lines = _format_head(
        "", "filter", "tilt, deg", "heading, deg", "better than CF by: tilt", "heading", "time, of CF's"
    )
    lines.append(
        _format_line(
            "the paper", KALMAN, "–", "–", f"{gain.tilt_deg:g}", f"{gain.heading_deg:g}", _format_ratio(gain[2])
        )
    )
    runs = {row["method"]: row for row in rows if "minutes" in row}
    for method, run in runs.items():
        tilt, heading = run["tilt_rmse_deg"], run["heading_rmse_deg"]
        gained = runs[CF]["tilt_rmse_deg"] - tilt, runs[CF]["heading_rmse_deg"] - heading
        figures = [f"{x:.2f}" for x in (tilt, heading, *gained)]
        lines.append(
            _format_line(
                f"{run['minutes']:g} min",
                method,
                *figures,
                _format_ratio(run["ns_per_sample"] / runs[CF]["ns_per_sample"]),
            )
        )
    return lines


def list_spin(scenario: Scenario, offline: _Rows, online: _Rows) -> list[str]:
    """Return one scenario of Asghari et al.: worst trial, and trials that the AEKF wins or shares, paper and ours."""
    lines = _format_head(scenario.name, "method", *_SPIN_COLUMNS)
    for words, rows, printed in (
        ("offline", offline, scenario.printed[False]),
        ("online", online, scenario.printed[True]),
    ):
        for method in OF_PAPER:
            figures = [f"{printed.worst.get((method, metric), '–')}" for metric in METRICS]
            if set(figures) != {"–"}:
                lines.append(_format_line(f"{words}, the paper", method, *figures))
        wins = [str(printed.wins[metric].get("AEKF", 0)) for metric in METRICS]
        lines.append(_format_line(f"{words}, the paper", "trials that the AEKF wins", *wins))
        for noise in NOISES:
            by = {method: _select(rows, noise=noise, method=method) for method in OF_PAPER}
            if not all(by.values()):
                continue
            for method, some in by.items():
                worst = [f"{max(row[metric] for row in some):.3g}" for metric in METRICS]
                lines.append(_format_line(f"{words}, `{noise}`", method, *worst))
            wins = [_count_best(by, metric) for metric in METRICS]
            lines.append(_format_line(f"{words}, `{noise}`", "trials that the AEKF wins or shares", *wins))
    return lines


def list_tens(*runs: _Rows) -> list[str]:
    """Return what each ten of seeds says under ``vibration-f4``, the hypothesis nearest to the printed counts."""
    lines = _format_head(
        "scenario",
        "seeds",
        "AEKF wins or shares: angle, largest",
        "angle, RMSE",
        "rate, largest",
        "rate, RMSE",
        "observation, worst angle RMSE, deg",
        "AEKF and EKF differ by at most, deg/s",
    )
    for scenario, rows in zip((CONSTANT, VARIABLE), runs, strict=True):
        printed = scenario.printed[False]
        wins = [str(printed.wins[metric]["AEKF"]) for metric in METRICS]
        observation = f"{printed.worst['observation', 'angle_rmse_deg']}"
        lines.append(_format_line(scenario.name, "the paper", *wins, observation, "–"))
        for first in range(0, len({row["seed"] for row in rows}), _TEN):
            ten = [row for row in rows if first <= row["seed"] < first + _TEN]
            by = {method: _select(ten, method=method) for method in OF_PAPER}
            worst = max(row["angle_rmse_deg"] for row in by["observation"])
            apart = max(
                abs(one["rate_rmse_degps"] - other["rate_rmse_degps"])
                for one, other in zip(by["EKF"], by["AEKF"], strict=True)
            )
            counts = [_count_best(by, metric) for metric in METRICS]
            lines.append(
                _format_line(scenario.name, f"{first}-{first + _TEN - 1}", *counts, f"{worst:.2f}", f"{apart:.1g}")
            )
    return lines


def list_auv(rows: _Rows) -> list[str]:
    """Return tables 1 and 2 of Zia beside ours; of means and headings the root mean square over the missions."""
    lines = _format_head("missions", "method", *_AUV_COLUMNS.values())
    for method, printed in PRINTED_FIGURES.items():
        figures = [f"{printed[key]:.2g}" if key in printed else "–" for key in _AUV_COLUMNS]
        lines.append(_format_line("the paper", method, *figures))
    for sea in SEAS:
        for method in dict.fromkeys(row["method"] for row in rows):
            some = _select(rows, sea=sea, method=method)
            if some:
                figures = [
                    f"{_summarise(some, key):.2g}" + (" (input)" if (method, key) in INPUTS else "")
                    for key in _AUV_COLUMNS
                ]
                lines.append(_format_line(f"`{sea}`", method, *figures))
    return lines


def list_servo(rows: _Rows) -> list[str]:
    """Return the rms errors of the bench of Byambajav et al., medians over the units, and the one printed number."""
    lines = _format_head("rms error, deg", "at rest", "0.1 Hz", "0.4 Hz")
    for words, short in _SERVO_ROWS.items():
        medians = [np.median([row[f"{short}_{part}_deg"] for row in rows]) for part in ("rest", "low", "high")]
        lines.append(_format_line(words, *(f"{x:.2g}" for x in medians)))
    drifts = [row["drift_deg"] for row in rows]
    lines += ["", *_format_head("the gyro alone after a minute, deg", "median size", "least", "most")]
    lines.append(_format_line("the paper, one unit", f"{abs(PRINTED_DRIFT_DEG):g}", f"{PRINTED_DRIFT_DEG:g}", "–"))
    figures = [f"{x:.0f}" for x in (np.median(np.abs(drifts)), min(drifts), max(drifts))]
    lines.append(_format_line(f"ours, {len(drifts)} units (input)", *figures))
    return lines


def list_gains() -> list[str]:
    """Return at how many frequencies the low pass of CF is below the envelope of the moving average."""
    lines = _format_head("CF", "ω0, rad/s", "ζ", "frequencies at which F is smaller than the mean over 7 s")
    for words, pair in (("as printed", PRINTED), ("slower", SLOWER)):
        below = find_frequencies_below_mean(pair)
        lines.append(_format_line(words, f"{pair.omega0_radps:g}", f"{pair.zeta:g}", f"{below.sum()} of {len(below)}"))
    return lines


def _introduce(table: Table) -> str:
    """Return the commands that give the figures of a table, and the band within which they agree."""
    commands = "; ".join(f"`stillpoint experiment {command}`" for command in table.commands)
    counted = f", counts of trials by {COUNT_BAND}" if table.counts else ""
    return f"{commands}. Band: {100 * SHARE_BAND:g} %{counted}."


def _format_head(*cells: str) -> list[str]:
    return [_format_line(*cells), "|" + "---|" * len(cells)]


def _format_line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _select(rows: _Rows, **wanted: str) -> list[_Row]:
    """Return the rows that have these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in wanted.items())]


def _format_mean(rows: _Rows, key: str) -> str:
    value = float(np.mean([row[key] for row in rows]))
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


def _format_ratio(ratio: float) -> str:
    return f"{ratio:.2g} times"


def _summarise(rows: _Rows, key: str) -> float:
    """Return the mean of a column of variances or RMSE, and the root mean square of any other column."""
    values = np.array([row[key] for row in rows])
    return float(values.mean() if key.endswith(("_deg2", "_rmse_deg")) else np.sqrt(np.mean(values**2)))


def _count_best(by: Mapping[str, _Rows], metric: str) -> str:
    """Count trials in which the AEKF has the smallest figure, or shares it."""
    columns = np.array([[row[metric] for row in by[method]] for method in OF_PAPER])
    best = columns[OF_PAPER.index("AEKF")] <= columns.min(axis=0) * (1 + EQUAL)
    return f"{int(best.sum())} of {columns.shape[1]}"


TABLES: dict[str, Table] = {
    "spin-constant": Table(
        lambda *runs: list_spin(CONSTANT, *runs),
        ("spin-constant", "spin-constant-online"),
        ("spin-constant", "spin-constant --online"),
        counts=True,
    ),
    "spin-variable": Table(
        lambda *runs: list_spin(VARIABLE, *runs),
        ("spin-variable", "spin-variable-online"),
        ("spin-variable", "spin-variable --online"),
        counts=True,
    ),
    "tens": Table(
        list_tens,
        ("spin-constant-60", "spin-variable-60"),
        ("spin-constant --noise vibration-f4 --trials 60", "spin-variable --noise vibration-f4 --trials 60"),
        counts=True,
    ),
    "phone": Table(list_phone, ("phone-1", "phone-2", "phone-3"), ("phone-1", "phone-2", "phone-3 --hand carried")),
    "gains": Table(list_gains, (), ("phone-1",)),
    "long": Table(list_long_run, ("phone-3",), ("phone-3 --hand carried --minutes 120",)),
    "auv": Table(list_auv, ("auv-dolphin",), ("auv-dolphin --sea calm",)),
    "servo": Table(list_servo, ("servo-bench",), ("servo-bench",)),
}


if __name__ == "__main__":
    run_program(main)
