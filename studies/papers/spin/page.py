"""The HTML page of an experiment of Asghari et al. 2018: figures per trial beside those that the paper prints."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from stillpoint.scoring.report.figures import COLOURS, ON_DARK
from stillpoint.scoring.report.pictures import Picture, make_picture
from stillpoint.scoring.report.provenance import flatten_params, list_versions
from stillpoint.scoring.report.spin_figures import draw_rates
from stillpoint.scoring.report.templates import load_template
from stillpoint.studies.papers.spin.figures import draw_bars
from stillpoint.studies.papers.spin.recorded import RECORDED
from stillpoint.studies.papers.spin.study import (
    FILTERS,
    METRICS,
    OF_PAPER,
    SMOOTHER,
    Scenario,
    Trial,
    count_in_order,
    count_wins,
    find_worst,
)

_METHODS = (*FILTERS, SMOOTHER)
_COLOUR = {"observation": 4, "EKF": 0, "AEKF": 1, "guarded": 2, "smoother": 3}  # places in COLOURS


class _Metric(NamedTuple):
    """An error of the scores and what the page calls it."""

    key: str
    name: str
    unit: str


_NAMED = (
    _Metric("angle_max_deg", "angle, largest error", "deg"),
    _Metric("angle_rmse_deg", "angle, RMSE", "deg"),
    _Metric("rate_max_degps", "rate, largest error", "deg/s"),
    _Metric("rate_rmse_degps", "rate, RMSE", "deg/s"),
)
assert tuple(metric.key for metric in _NAMED) == METRICS


def make_spin_page(scenario: Scenario, trials: Mapping[str, Sequence[Trial]], online: bool, command: str) -> str:
    """Return the page; ``trials`` by noise, each with at least one trial. The same trials give the same bytes.

    Those of recordings stand under the names of their judges.
    """
    methods = [m for m in _METHODS if any(m in one.scores for some in trials.values() for one in some)]
    first = next(iter(trials.values()))
    return load_template("stillpoint.studies.papers.spin", "page.html.j2").render(
        colours=COLOURS,
        colours_on_dark=ON_DARK,
        title=scenario.title,
        online=online,
        facts=_list_facts(scenario, first, online, methods, trials),
        scenario=scenario.name,
        counted=_count_wins(scenario, trials, online),
        shaken=_describe_vibration(trials.get("vibration", ())),
        recorded=set(trials) <= set(RECORDED),
        worst_of={noise: _summarise_trials(some) for noise, some in trials.items()},
        metrics=_NAMED,
        of_paper=OF_PAPER,
        has_smoother=SMOOTHER in methods,
        worst=_list_worst_rows(scenario, trials, online, methods),
        wins=_make_win_rows(scenario, trials, online, methods),
        sections=[_make_section(noise, some, scenario, online, methods) for noise, some in trials.items()],
        command=command,
        parameters=_format_parameters(trials),
        versions=list_versions(),
    )


def _list_facts(
    scenario: Scenario,
    first: Sequence[Trial],
    online: bool,
    methods: Sequence[str],
    trials: Mapping[str, Sequence[Trial]],
) -> dict[str, str]:
    """Return facts about the trials by their titles, as text."""
    seeds = [one.seed for one in first]
    if set(trials) <= set(RECORDED):
        facts = {
            "recordings": f"{len(first)}, numbered from {seeds[0]} on in the order in which they were given",
            "scored": "at every sample for which there is a judge, not only at moving ones; the angle counts from the "
            "first one",
        }
    else:
        facts = {
            "trials": f"{len(seeds)} of {scenario.seconds:g} s per noise, T = 4 ms, seeds {seeds[0]} to {seeds[-1]}",
            "scored": "against the simulated truth at every sample; the angle counts from the first one",
        }
    facts |= {
        "computed": "fed sample by sample through the stream, in single precision, as on a microcontroller"
        if online
        else "whole recordings, in double precision",
        "methods": ", ".join(methods),
    }
    refused = {reason for some in trials.values() for one in some for reason in one.refused.values()}
    return facts | ({"refused": "; ".join(sorted(refused))} if refused else {})


def _count_wins(scenario: Scenario, trials: Mapping[str, Sequence[Trial]], online: bool) -> dict[str, str]:
    """Return by noise in how many trials the methods rank as in the paper, and in how many the AEKF won there."""
    counts: dict[str, str] = {}
    for noise, some in trials.items():
        counts[noise] = f"{count_in_order(some, 'rate_rmse_degps', OF_PAPER)} of {len(some)}"
    printed = scenario.printed[online].wins["rate_rmse_degps"].get("AEKF", 0)
    return {**counts, "the paper": f"{printed} of {5 if online else 10}"}


def _summarise_trials(trials: Sequence[Trial]) -> dict[str, str]:
    """Return the observation's worst angle RMSE, and the trials in which the AEKF is best or equal, by metric."""
    worst = find_worst(trials, "observation", "angle_rmse_deg")
    wins = [str(count_wins(trials, metric, OF_PAPER)["AEKF"]) for metric in METRICS]
    return {"observation": "–" if worst is None else f"{worst:.2f}", "wins": "/".join(wins)}


def _describe_vibration(trials: Sequence[Trial]) -> str:
    """Return a sentence: which of the paper's methods has the least errors of the rate under vibration of the motor."""
    if not trials:
        return ""
    least = []
    for metric, name in (("rate_rmse_degps", "RMSE"), ("rate_max_degps", "largest error")):
        counts = ", ".join(f"{method} in {n}" for method, n in count_wins(trials, metric, OF_PAPER).items() if n)
        least.append(f"the least {name} of the rate has {counts}")
    return f"Where D5 is the vibration of the motor, of {len(trials)} trials {'; '.join(least)}."


def _list_worst_rows(
    scenario: Scenario, trials: Mapping[str, Sequence[Trial]], online: bool, methods: Sequence[str]
) -> list[dict[str, Any]]:
    """Return the rows of the worst figures: the paper's, then each method under each noise."""
    printed = scenario.printed[online].worst
    rows: list[dict[str, Any]] = [
        {
            "noise": "the paper" if method == OF_PAPER[0] else "",
            "method": method,
            "figures": [printed.get((method, metric)) for metric in METRICS],
            "of_paper": True,
            "first": False,
            "colour": None,
        }
        for method in OF_PAPER
    ]
    for noise, some in trials.items():
        rows += [
            {
                "noise": noise if method == methods[0] else "",
                "method": method,
                "figures": [find_worst(some, method, metric) for metric in METRICS],
                "of_paper": False,
                "first": method == methods[0],
                "colour": _COLOUR[method],
            }
            for method in methods
        ]
    return rows


def _make_win_rows(
    scenario: Scenario, trials: Mapping[str, Sequence[Trial]], online: bool, methods: Sequence[str]
) -> list[dict[str, Any]]:
    """Return the rows of how often each method is best: the paper's, then each noise."""
    printed = scenario.printed[online].wins
    rows: list[dict[str, Any]] = [
        {
            "noise": "the paper",
            "of_paper": True,
            "cells": [" / ".join(str(printed[m].get(one, 0)) for one in OF_PAPER) for m in METRICS],
        }
    ]
    for noise, some in trials.items():
        cells = []
        for metric in METRICS:
            three, all_of_them = count_wins(some, metric, OF_PAPER), count_wins(some, metric, methods)
            others = sum(count for method, count in all_of_them.items() if method not in OF_PAPER)
            cells.append(f"{' / '.join(str(three[method]) for method in OF_PAPER)} ({others})")
        rows.append({"noise": noise, "of_paper": False, "cells": cells})
    return rows


def _make_section(
    noise: str, trials: Sequence[Trial], scenario: Scenario, online: bool, methods: Sequence[str]
) -> dict[str, Any]:
    """Return pictures and rows of the trials under one noise."""
    numbers = scenario.printed[online].figures
    bars = [_draw_bars(noise, trials, metric, methods, numbers[metric.key]) for metric in _NAMED]
    return {
        "noise": noise,
        "pictures": [*_draw_rates(noise, trials[0], scenario, methods), *bars],
        "rows": [_make_row(one, method) for one in trials for method in methods if method in one.scores],
    }


def _make_row(one: Trial, method: str) -> dict[str, Any]:
    """Return the row of one method in one trial."""
    s = one.scores[method]
    fits = [s.angle_nees, s.rate_nees, s.angle_coverage95, s.rate_coverage95]
    return {"seed": one.seed, "method": method, "figures": [*(getattr(s, metric) for metric in METRICS), *fits]}


def _draw_bars(noise: str, trials: Sequence[Trial], metric: _Metric, methods: Sequence[str], number: str) -> Picture:
    """Return the picture of one figure as bars, one group per trial."""
    return make_picture(
        f"{metric.name[0].upper()}{metric.name[1:]} ({noise})",
        f"As the paper's figure {number}: one group of bars per trial.",
        1,
        230,
        lambda axes: draw_bars(axes[0], trials, metric.key, {m: _COLOUR[m] for m in methods}, metric.unit),
        time_axis=False,
    )


def _draw_rates(noise: str, one: Trial, scenario: Scenario, methods: Sequence[str]) -> list[Picture]:
    """Return the picture of the rates over time; no picture of a trial without series."""
    if one.series is None:
        return []
    series = one.series
    number = {"spin-constant": "9", "spin-variable": "18"}[scenario.name]
    shown = {method: _COLOUR[method] for method in methods if method in series.rate_radps}
    drawn = make_picture(
        f"Rate over time ({noise})",
        f"As the paper's figure {number}: trial {one.seed}. Errors are estimate minus truth.",
        1 + len(shown),
        105,
        lambda axes: draw_rates(axes, series, shown),
    )
    return [drawn]


def _format_parameters(trials: Mapping[str, Sequence[Trial]]) -> dict[str, str]:
    """Return the parameters of each method as text, by noise where they differ."""
    found: dict[str, dict[str, str]] = {}
    for noise, some in trials.items():
        for method, params in some[0].params.items():
            text = "; ".join(f"{key} = {value}" for key, value in flatten_params(params))
            found.setdefault(method, {})[noise] = text
    shown = {}
    for method, by_noise in found.items():
        if len(set(by_noise.values())) == 1:
            shown[method] = next(iter(by_noise.values()))
        else:
            shown |= {f"{method} ({noise})": text for noise, text in by_noise.items()}
    return shown
