"""The sentence below a table: what the recordings decide between the estimators, and for what it holds."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from stillpoint.studies.leaderboard.board import Pair, Row, Source, Summary, Table
from stillpoint.studies.leaderboard.verdicts import LEAST_ROWS

_MOST_NAMES = 6  # listed in a sentence; more are counted


def write_conclusion(table: Table, sources: Sequence[Source], unusable: Sequence[str]) -> Table:
    """Return the table with its conclusion.

    ``sources`` are the recordings that count; on the ``unusable`` ones every estimator failed.
    """
    sentences = []
    ranked = [row for row in table.rows if row.rank is not None]
    if not ranked:
        sentences.append(f"No estimator could be scored on all {_format_count(len(sources), 'recording')}.")
    else:
        sentences += [_name_best(table, ranked, sources), _count_decided(table)]
        sentences.append(_state_limits(table, sources))
    if table.why_ranked_by:
        sentences.append(f"Ranked by inclination: {table.why_ranked_by}.")
    failed = [row for row in table.rows if row.failed]
    if failed:
        listed = ", ".join(f"{row.label} failed on {row.failed} of {row.recordings}" for row in failed[:_MOST_NAMES])
        more = f" and {len(failed) - _MOST_NAMES} others failed on some" if len(failed) > _MOST_NAMES else ""
        sentences.append(f"Not ranked: {listed}{more}.")
    turned = [row.label for row in table.rows if row.rank is None and not row.failed and sources]
    if turned:
        sentences.append(
            f"Not ranked by the {table.ranked_by} error: {_format_names(turned)}, whose heading has no meaning."
        )
    if unusable:
        sentences.append(f"Every estimator failed on {_format_names(unusable)}.")
    return replace(table, conclusion=" ".join(sentences))


def _name_best(table: Table, ranked: Sequence[Row], sources: Sequence[Source]) -> str:
    """Return which estimator has the least error, how many others it beats, and which ones it does not."""
    best = min(ranked, key=lambda row: _get_summary(row, table).typical)
    summary = _get_summary(best, table)
    over = f"Over {_format_count(len(sources), 'recording')}"
    if table.independent_rows < len(sources):
        over += f" ({table.independent_rows} of different device or motion)"
    what = "error" if table.ranked_by == "total" else f"{table.ranked_by} error"
    low, high = summary.ci95
    size = f"{summary.typical:.2f}°" + (f", {low:.2f}-{high:.2f}" if table.general else "")
    text = f"{over}, judged by {table.against}, {best.label} has the least {what} ({size})"
    mine = [pair for pair in table.pairs if best.label in (pair.a, pair.b)]
    if not mine:
        return f"{text}."
    beaten = sum(_find_winner(pair) == best.label for pair in mine)
    text += f" and is better than {beaten} of {_format_count(len(mine), 'other')}"
    near = sorted((_find_ratio(pair, best.label) for pair in mine if pair.verdict == "undecided"), key=lambda r: -r[0])
    if near:
        listed = ", ".join(
            f"{name} (ratio {ratio:.2f}{f', {low:.2f}-{high:.2f}' if table.general else ''})"
            for ratio, low, high, name in near[:3]
        )
        more = f" and {len(near) - 3} more" if len(near) > 3 else ""
        text += f"; it cannot be distinguished from {listed}{more}"
    return f"{text}."


def _count_decided(table: Table) -> str:
    """Return how many pairs of the table are decided, as a sentence."""
    decided = sum(pair.verdict != "undecided" for pair in table.pairs)
    if not table.pairs:
        return "There is no pair to compare."
    counted = f"{decided} of {_format_count(len(table.pairs), 'pair')}"
    if not table.general:
        return f"{counted} differ by more than 5 % on these recordings."
    return f"{counted} are decided, of which at most 5 % may point the wrong way."


def _state_limits(table: Table, sources: Sequence[Source]) -> str:
    """Return for which recordings the table holds, as a sentence."""
    devices = Counter(source.device or "unknown device" for source in sources)
    motions = {source.motion for source in sources if source.motion}
    held = f"devices: {_format_names(list(devices))}"
    if motions:
        held += f"; motions: {_format_names(sorted(motions))}"
    if table.general:
        return f"This holds for recordings like these ({held}), not for other devices."
    return f"With fewer than {LEAST_ROWS} independent recordings this holds for these recordings only ({held})."


def _find_winner(pair: Pair) -> str:
    return {"a": pair.a, "b": pair.b, "undecided": ""}[pair.verdict]


def _find_ratio(pair: Pair, best: str) -> tuple[float, float, float, str]:
    """Return the ratio of ``best`` over the other with its interval, and the other's label."""
    if pair.a == best:
        return pair.ratio, *pair.ci95, pair.b
    return 1 / pair.ratio, 1 / pair.ci95[1], 1 / pair.ci95[0], pair.a


def _get_summary(row: Row, table: Table) -> Summary:
    """Return the figures by which the table is ranked."""
    found: Summary = getattr(row, f"{table.ranked_by}_rmse_deg")
    return found


def _format_count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _format_names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMES])
    return shown if len(names) <= _MOST_NAMES else f"{shown} and {len(names) - _MOST_NAMES} more"
