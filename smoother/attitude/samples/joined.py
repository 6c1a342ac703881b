"""The answers of overlapping windows as one: in an overlap it goes over linearly in time from one to the next."""

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from stillpoint.datasets.frames import quaternion, rotation
from stillpoint.datasets.recording import Floats
from stillpoint.smoother.attitude.keys import Motion
from stillpoint.smoother.attitude.samples.every_sample import Piece, Samples, Track, sample_attitudes, sample_piece


def sample_pieces(pieces: Sequence[Piece], motion: Motion) -> Iterator[Samples]:
    """Yield the joined answer of all windows at every sample, in the order of time, about a window at once.

    The mean heading is as well known as in the best window; the excess variance of another window's mean heading is
    added to its own covariance.
    """
    if len(pieces) == 1:
        yield sample_piece(pieces[0], motion)
        return
    best = min(piece.heading_rad2 for piece in pieces)
    open_: Samples | None = None  # what the windows so far say, from the first sample on that the next one may change
    for piece, after in zip(pieces, [*pieces[1:], None], strict=True):
        here = sample_piece(piece, motion)
        up_b = rotation(here.q_nb).as_matrix()[:, 2]
        excess = (piece.heading_rad2 - best) * up_b[:, :, None] * up_b[:, None, :]
        here = replace(here, cov_b_rad2=here.cov_b_rad2 + excess)
        joined = here if open_ is None else _join(open_, here, motion.t_s)
        if after is None:
            yield joined
            return
        ready = after.rows.start - joined.rows.start
        if ready > 0:
            yield _cut(joined, slice(0, ready))
        open_ = _cut(joined, slice(max(ready, 0), None))


def join_attitudes(pieces: Sequence[Piece], motion: Motion) -> Floats:
    """Return the attitude (N, 4) at every sample, as :func:`sample_pieces` does, but sooner: without covariances."""
    q_nb, done = np.empty((len(motion.t_s), 4)), 0
    for piece in pieces:
        rows = piece.rows
        here, _ = sample_attitudes(piece, motion)
        if done > rows.start:
            both = slice(rows.start, done)
            here[: done - rows.start] = _turn_over(q_nb[both], here[: done - rows.start], _rise(motion.t_s[both]))
        q_nb[rows], done = here, rows.stop
    return q_nb


def _join(before: Samples, after: Samples, t_s: Floats) -> Samples:
    """Return the samples of two windows as one; ``after`` begins where ``before`` does, and ends later."""
    old = before.rows.stop - after.rows.start
    if old <= 0:
        return after
    share = _rise(t_s[before.rows])
    turned = _turn_over(before.q_nb, after.q_nb[:old], share)
    return Samples(
        rows=after.rows,
        q_nb=np.concatenate([turned, after.q_nb[old:]]),
        cov_b_rad2=_go_over(before.cov_b_rad2, after.cov_b_rad2, share),
        gyro_bias_b_radps=_go_over(before.gyro_bias_b_radps, after.gyro_bias_b_radps, share),
        track=_join_tracks(before.track, after.track, share),
    )


def _rise(t_s: Floats) -> Floats:
    """Return times (N,) as shares of their span, from 0 to 1."""
    return np.asarray((t_s - t_s[0]) / (t_s[-1] - t_s[0]))


def _turn_over(before_q_nb: Floats, after_q_nb: Floats, share: Floats) -> Floats:
    """Return attitudes (N, 4) that go over from one to another by a share (N,)."""
    turn = rotation(before_q_nb)
    step = (turn.inv() * rotation(after_q_nb)).as_rotvec()
    return quaternion(turn * Rotation.from_rotvec(share[:, None] * step))


def _go_over(before: Floats, after: Floats, share: NDArray[np.float64]) -> Floats:
    """Return ``after`` (N, ...), of which the first rows go over linearly from ``before`` (M, ...) by a share (M,)."""
    part = share.reshape(-1, *[1] * (before.ndim - 1))
    return np.concatenate([(1 - part) * before + part * after[: len(before)], after[len(before) :]])


def _join_tracks(before: Track | None, after: Track | None, share: Floats) -> Track | None:
    if before is None or after is None:
        return None
    names = [each.name for each in fields(Track)]
    return Track(**{name: _go_over(getattr(before, name), getattr(after, name), share) for name in names})


def _cut(samples: Samples, which: slice) -> Samples:
    """Return some of the samples."""
    first, stop, _ = which.indices(len(samples.q_nb))
    track = samples.track
    if track is not None:
        track = Track(**{each.name: getattr(track, each.name)[which] for each in fields(Track)})
    return Samples(
        rows=slice(samples.rows.start + first, samples.rows.start + stop),
        q_nb=samples.q_nb[which],
        cov_b_rad2=samples.cov_b_rad2[which],
        gyro_bias_b_radps=samples.gyro_bias_b_radps[which],
        track=track,
    )
