"""Report a solved graph as a reference, with everything that was found about the sensor and the rests."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from stillpoint.datasets.recording import Floats, Recording
from stillpoint.datasets.times import find_gaps
from stillpoint.datasets.trajectory import CONVENTION, BasePoseReturn
from stillpoint.smoother.attitude.covariance import choose_factors, compute_bending, scale_covariances
from stillpoint.smoother.attitude.evidence import Evidence, describe_gravity_test
from stillpoint.smoother.attitude.outside.satellite import VERTICAL, estimate_delay, outages
from stillpoint.smoother.attitude.plausibility import (
    describe_disturbed_field,
    describe_lasting_errors,
    measure_surprise,
)
from stillpoint.smoother.attitude.returns import judge_returns_again
from stillpoint.smoother.attitude.samples.every_sample import Piece, Track
from stillpoint.smoother.attitude.samples.joined import join_attitudes, sample_pieces
from stillpoint.smoother.attitude.windows import Solved
from stillpoint.smoother.long_reference import Columns, LongReference

_LEAST_FACTOR_OF_GAPS, _LEAST_FACTOR_OF_RESTORED = 1.0, 0.4  # on the variances
_SLOW_S = 0.02  # between readings; with shorter steps, splines add next to nothing


def report_reference(
    recording: Recording, evidence: Evidence, solved: Solved, magnetometer_left_out: str | None
) -> LongReference:
    """Return the pieces of a solved graph as one reference; mounting and calibration are those of the last window.

    ``magnetometer_left_out`` says why the magnetometer was not used, None where it was or where there is none.
    """
    pieces, motion, t_ns = solved.pieces, evidence.motion, recording.require_imu().t_ns
    last = pieces[-1]  # it has seen all data
    q_nb = join_attitudes(pieces, motion)
    verdicts: tuple[BasePoseReturn, ...] = ()
    if evidence.base is not None and evidence.returns is not None:
        verdicts = judge_returns_again(evidence.base, evidence.returns, q_nb, last.common_q_nb, solved.params)
    closing = _select_closing_squares(evidence, verdicts, pieces)
    factors = choose_factors(
        closing, len(evidence.rests_ns) > 0, _find_least_factor(recording, evidence), solved.params
    )
    diagnostics = _list_diagnostics(recording, evidence, solved, q_nb) | {
        "closing_squares": closing,
        "variance_factors": asdict(factors),
    }
    if magnetometer_left_out is not None:
        diagnostics["magnetometer_left_out"] = magnetometer_left_out
    disturbed = describe_disturbed_field(solved.fit, solved.params)
    lasting = describe_lasting_errors(solved.fit, solved.params)
    held = evidence.fixes is not None or any(verdict.accepted for verdict in verdicts)
    if disturbed:
        diagnostics["field_disturbed"] = f"{disturbed}; only the readings that fit are used"
    elif lasting and not held:
        diagnostics["field_disturbed"] = f"{lasting}, and nothing else holds the heading"
    bent, of_mean = compute_bending(evidence.keys, solved.params)
    facts: dict[str, Any] = {
        "heading_sd_rad": float(np.sqrt(factors.mean_heading * min(piece.heading_rad2 for piece in pieces))),
        "mounting_cov_b_rad2": factors.tilt * last.mounting_b_rad2 + of_mean,
        "method": "graph",
        "name": recording.name,
        "calibration": last.calibration,  # its sd is mostly that of the prior, to which no factor applies
        "rests_ns": evidence.rests_ns,
        "returns": verdicts,
        "diagnostics": diagnostics,
    }
    rows = evidence.keys.row
    fix_m2 = None
    if evidence.fixes is not None:
        fix_m2 = float(np.median(evidence.fixes.sd_m)) ** 2
        facts["origin_lat_lon_alt"] = evidence.fixes.origin

    def make_columns() -> Iterator[Columns]:
        for part in sample_pieces(pieces, motion):
            interval = np.searchsorted(rows[1:-1], np.arange(part.rows.start, part.rows.stop))
            yield {
                "t_ns": t_ns[part.rows],
                "q_nb": part.q_nb,
                "cov_b_rad2": scale_covariances(part.cov_b_rad2, part.q_nb, factors) + bent[interval],
                "gyro_bias_b_radps": part.gyro_bias_b_radps,
                **_state_track(part.track, fix_m2),
            }

    return LongReference(len(t_ns), facts, make_columns)


def _state_track(track: Track | None, fix_m2: float | None) -> Columns:
    """Return the columns of position and velocity, none where there are no satellites.

    Errors of fixes wander over minutes and do not average out: the variance of one fix, ``fix_m2``, is added to the
    position's.
    """
    if track is None or fix_m2 is None:
        return {}
    wander = np.diag([1.0, 1.0, VERTICAL**2]) * fix_m2
    return {
        "position_n_m": track.position_n_m,
        "velocity_n_mps": track.velocity_n_mps,
        "position_cov_n_m2": track.position_cov_n_m2 + wander,
        "velocity_cov_n_m2ps2": track.velocity_cov_n_m2ps2,
    }


def _describe_fixes(evidence: Evidence, solved: Solved, q_nb: Floats) -> dict[str, Any]:
    """Return what became of the satellite fixes."""
    fixes = evidence.fixes
    if fixes is None:
        return {}
    out_s = outages(fixes)
    return {
        "fixes": {
            "used": len(fixes.state),
            "n_jumps": fixes.jumps,
            "n_without_imu": fixes.without_state,
            "n_doubtful": solved.n_doubtful_fixes,
            "n_outages": len(out_s),
            "longest_outage_s": float(out_s.max(initial=0.0)),
            "sd_m": float(np.median(fixes.sd_m)),
            "delay_s": estimate_delay(fixes, evidence.motion, q_nb),
        }
    }


def _select_closing_squares(
    evidence: Evidence, verdicts: tuple[BasePoseReturn, ...], pieces: list[Piece]
) -> list[float]:
    """Return the closing squares of the returns that are accepted before and after the solution.

    A return that was put back turned says nothing about the gyro.
    """
    if evidence.returns is None:
        return []
    pairs = zip(evidence.returns.verdicts, verdicts, strict=True)
    kept = [after.accepted for before, after in pairs if before.accepted]
    squares = [square for piece in pieces for square in piece.closing_squares]
    return [square for square, good in zip(squares, kept, strict=True) if good]


def _list_diagnostics(recording: Recording, evidence: Evidence, solved: Solved, q_nb: Floats) -> dict[str, Any]:
    gap = find_gaps(recording.require_imu().t_ns)
    inertial, last = solved.params.inertial, solved.pieces[-1]
    return {
        "heading": evidence.heading,
        "sign_of_gravity": describe_gravity_test(recording, evidence),
        "n_rests_under_way": evidence.n_rests_under_way,
        "gaps": int(gap.sum()),
        "longest_gap_s": float(evidence.motion.dt_s[1:][gap].max(initial=0.0)),
        "windows": len(solved.pieces),
        "iterations": max(piece.iterations for piece in solved.pieces),
        "cost": sum(piece.cost for piece in solved.pieces),
        "residuals": solved.fit.squares,
        "field_sd_ut": solved.fit.field_sd_ut,
        "field_widening": last.field_widening,
        "gyro_bias_prior_sd_radps": inertial.gyro_bias_sd_radps,
        "gyro_matrix_prior_sd": inertial.gyro_matrix_sd,
        "gyro_scale_prior_sd": inertial.gyro_scale_sd,
        "accel_matrix_prior_sd": inertial.accel_matrix_sd,
        "accel_late_sd_s": last.late_sd_s,
        "calibration_surprise_sd": measure_surprise(last.calibration, solved.params),
        "field_inlier_share": solved.fit.field_inlier_share,
        "field_misfit_ut": solved.fit.field_misfit_ut,
        "slow_log": _describe_slow_log(evidence),
        "convention": CONVENTION,
        **_describe_fixes(evidence, solved, q_nb),
    }


def _find_least_factor(recording: Recording, evidence: Evidence) -> float:
    """Return the least factor on the variances, which were calibrated on recordings that miss nothing.

    Gaps, also short ones that are bridged, and dropped samples hide some of the motion. The splines between the
    readings of a slow log restore nearly all of it.
    """
    motion = evidence.motion
    in_gap = find_gaps(recording.require_imu().t_ns) & ~motion.at_rest[1:]
    slow = motion.gyro_sampling_radps.any()
    if evidence.keys.gap.any() or in_gap.any() or (slow and not evidence.restored):
        return _LEAST_FACTOR_OF_GAPS
    return _LEAST_FACTOR_OF_RESTORED if slow and float(np.median(motion.dt_s)) >= _SLOW_S else 0.0


def _describe_slow_log(evidence: Evidence) -> str | None:
    """Return what the covariance knows of rates that are sampled slowly; None where that is not noticed."""
    motion = evidence.motion
    if not motion.gyro_sampling_radps.any():
        return None
    rate_hz = 1 / float(np.median(motion.dt_s))
    wrong_degps = np.rad2deg(np.sqrt(np.mean(motion.gyro_sampling_radps[~motion.at_rest] ** 2)))
    restored = "restored" if evidence.restored else "not restored: samples were dropped"
    return (
        f"readings at {rate_hz:.0f} Hz; the motion between them is {restored}; the covariance allows for rates "
        f"that are wrong by {wrong_degps:.2f} deg/s (RMS)"
    )
