"""Score an estimate and a truth that come in pieces: the same bits as :func:`~stillpoint.scoring.score.score` gives.

Each piece is read once. What later passes need is kept in stores that the caller chooses: lists, or temporary files,
with which the memory does not grow with the length. The passes are: both trajectories, for the usual steps between
their samples; pairs at the stamps of the sparser one; the alignment; the errors; their quantiles.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillpoint.datasets.errors import BadParameter, Unobservable
from stillpoint.datasets.frames import EulerFrame
from stillpoint.datasets.recording import Floats, Truth
from stillpoint.datasets.trajectory import Estimate, Reference
from stillpoint.scoring.align import AlignKind, Alignment, align_blocks
from stillpoint.scoring.blocks import Store, find_quantiles, join_rows
from stillpoint.scoring.compare import find_moving, name_of
from stillpoint.scoring.match import (
    Track,
    describe_none,
    find_unready,
    get_attitude,
    is_sparser,
    label_of,
    match,
    pair_up,
)
from stillpoint.scoring.score import Score, ScoredPairs, score_blocks

ALIGN_PIECES: tuple[AlignKind, ...] = ("none", "heading", "heading+mounting")  # a clock needs the whole
Rows = NDArray[np.void]


def score_pieces(
    estimated: Iterable[Estimate],
    truth: Iterable[Reference | Truth],
    align: AlignKind = "heading",
    frame: EulerFrame = "nwu",
    new_store: Callable[[], Store] = list,
) -> Score:
    """Score an estimate against a truth, both in pieces, each with all facts of the whole.

    Raises as :func:`~stillpoint.scoring.score.score`, and :class:`BadParameter` for an alignment of the clock.
    """
    if align not in ALIGN_PIECES:
        raise BadParameter(f"align: {align!r} is not one of {', '.join(ALIGN_PIECES)}, which pieces allow")
    source, judge = _Stored(new_store()), _Stored(new_store())
    judge.take(truth)
    if not judge.moving:
        raise Unobservable(f"{judge.name}: no sample of it moves, so there is nothing to score")
    source.take(estimated)
    outside, in_gap, unready = _count_unmatched(source, judge)
    pairs = new_store()
    count = 0
    for rows in join_rows(_list_moving_pairs(source, judge)):
        pairs.append(rows)
        count += len(rows)
    if not count:
        if judge.moving == outside + in_gap + unready:
            raise Unobservable(describe_none(source.part.label, judge.moving, (outside, in_gap, unready)))
        raise Unobservable(f"{source.part.label}: none of its poses lies in a moving stretch of the truth")
    alignment = align_blocks(((rows["q_est"], rows["q_true"]) for rows in pairs), align)
    facts = {
        "estimated": source.name,
        "against": judge.name,
        "recording": source.recording,
        "samples_outside": outside,
        "samples_in_gap": in_gap,
        "samples_unready": unready,
        "moving_share": judge.moving / judge.count,
    }
    return score_blocks((_align_rows(rows, alignment) for rows in pairs), count, alignment, frame, facts, new_store)


class _Stored:
    """A trajectory in a store, with the facts of the whole; its rows also say where a truth moves."""

    def __init__(self, store: Store) -> None:
        """Begin without samples; the store keeps them between two passes."""
        self.store = store
        self.name = self.recording = ""
        self.count = self.moving = 0
        self.part: Track  # no samples, and the facts of the whole

    def take(self, pieces: Iterable[Estimate | Reference | Truth]) -> None:
        """Keep all pieces."""
        label, has_cov, first_ns, last_ns = "", False, 0, 0
        for piece in pieces:
            if not self.count:
                label, self.name, first_ns = label_of(piece), name_of(piece), int(piece.t_ns[0])
                self.recording = piece.recording if isinstance(piece, Estimate) else ""
                has_cov = not isinstance(piece, Truth) and piece.cov_b_rad2 is not None
            last_ns = int(piece.t_ns[-1])
            self._append_piece(piece, has_cov)
        cov = np.empty((0, 3, 3)) if has_cov else None
        none = np.empty(0, np.int64)
        step_ns = find_quantiles(_Steps(self.store), self.count - 1, (0.5,))[0] if self.count > 1 else 0.0
        self.part = Track(label, none, np.empty((0, 4)), cov, none.astype(np.bool_), step_ns, (first_ns, last_ns))

    def _append_piece(self, piece: Estimate | Reference | Truth, has_cov: bool) -> None:
        """Append stamps, attitudes and masks of a piece to the store, with covariances where it has them."""
        cov = [("cov_b_rad2", np.float64, (3, 3))] if has_cov else []
        rows = np.empty(
            len(piece.t_ns), [("t_ns", np.int64), ("q_nb", np.float64, 4), ("unready", "?"), ("moving", "?"), *cov]
        )
        rows["t_ns"], rows["q_nb"], rows["unready"] = piece.t_ns, get_attitude(piece), find_unready(piece)
        rows["moving"] = False if isinstance(piece, Estimate) else find_moving(piece)
        if has_cov:
            rows["cov_b_rad2"] = piece.cov_b_rad2  # type: ignore[union-attr]
        self.store.append(rows)
        self.count += len(rows)
        self.moving += int(rows["moving"].sum())

    def track(self, rows: Rows) -> Track:
        """Return some rows as a part of the trajectory."""
        cov = None if self.part.cov_b_rad2 is None else np.ascontiguousarray(rows["cov_b_rad2"])
        columns = (np.ascontiguousarray(rows["t_ns"]), np.ascontiguousarray(rows["q_nb"]), cov, rows["unready"])
        return Track(self.part.label, *columns, self.part.step_ns, self.part.span_ns)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps between the samples of a store, as arrays."""

    store: Store

    def __iter__(self) -> Iterator[NDArray[np.int64]]:
        """Yield the steps between neighbouring stamps in ns, across the ends of blocks too."""
        last = np.empty(0, np.int64)
        for rows in self.store:
            t_ns = np.concatenate([last, rows["t_ns"]])
            last = t_ns[-1:]
            yield np.diff(t_ns)


def _walk_windows(at: _Stored, around: _Stored) -> Iterator[tuple[Rows, Rows]]:
    """Yield all rows of one trajectory in parts, each with the rows of the other that interpolation there needs.

    These reach from the sample at or before the first stamp to one after the last, as far as there are any.
    """
    others = iter(around.store)
    near = next(others)
    for rows in at.store:
        while len(rows):
            ready = int(np.searchsorted(rows["t_ns"], near["t_ns"][-1]))  # a sample follows these
            following = None if ready == len(rows) else next(others, None)
            if ready < len(rows) and following is None:
                ready = len(rows)  # none follows, and the last two samples are there
            if ready:
                yield rows[:ready], near
            if ready < len(rows):
                first = int(np.searchsorted(near["t_ns"], rows["t_ns"][ready], side="right")) - 1
                near = near[max(min(first, len(near) - 2), 0) :]
            if following is not None:
                near = np.concatenate([near, following])
            rows = rows[ready:]


def _count_unmatched(source: _Stored, judge: _Stored) -> tuple[int, int, int]:
    """Return how many moving samples of the truth lie outside the estimate, in its gaps, and where it was not ready."""
    total = np.zeros(3, np.int64)
    for rows, near in _walk_windows(judge, source):
        total += match(source.track(near), rows["t_ns"][rows["moving"]]).counts()
    outside, in_gap, unready = total.tolist()
    return outside, in_gap, unready


def _list_moving_pairs(source: _Stored, judge: _Stored) -> Iterator[Rows]:
    """Yield the moving pairs, at the stamps of the sparser trajectory."""
    swap = is_sparser(source.part, judge.part)
    for rows, near in _walk_windows(source, judge) if swap else _walk_windows(judge, source):
        ours, theirs = (rows, near) if swap else (near, rows)
        found = pair_up(source.track(ours), judge.track(theirs), theirs["moving"])
        columns = {"q_est": found.q_est, "q_true": found.q_true}
        columns |= {} if found.cov_b_rad2 is None else {"cov_b_rad2": found.cov_b_rad2}
        columns |= {} if found.true_cov_b_rad2 is None else {"true_cov_b_rad2": found.true_cov_b_rad2}
        kept = np.empty(
            int(found.moving.sum()), [(name, np.float64, values.shape[1:]) for name, values in columns.items()]
        )
        for name, values in columns.items():
            kept[name] = values[found.moving]
        if len(kept):
            yield kept


def _align_rows(rows: Rows, alignment: Alignment) -> ScoredPairs:
    """Return rows of paired attitudes with the alignment applied to the estimate."""

    def get_column(name: str) -> Any:
        return np.ascontiguousarray(rows[name]) if name in (rows.dtype.names or ()) else None

    cov: Floats | None = get_column("cov_b_rad2")
    q_est = alignment.attitude(get_column("q_est"))
    return ScoredPairs(
        q_est, get_column("q_true"), None if cov is None else alignment.covariance(cov), get_column("true_cov_b_rad2")
    )
