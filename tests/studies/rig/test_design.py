"""Where the accelerometers should sit: the paper's numbers, eq (27), and the filter's steady state."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from stillpoint.datasets import BadParameter
from stillpoint.studies.rig.design import (
    Rig,
    compute_limits_m,
    compute_steady_variance,
    evaluate_placement,
    find_longest_arms,
)
from stillpoint.studies.rig.figures import draw_both, draw_radial, draw_tangential

PAPER = Rig()  # 2000 deg/s, reached in 0.2 s, +-16 g, D4 = 0.8, D5 = 0.12


def test_the_design_finds_the_papers_limits_and_its_choice():
    """Section 3.2: F4 reads 16 g at 13 cm and sits at 10; F5 could sit at 0.9 m and has room for 0.5."""
    assert compute_limits_m(PAPER) == (pytest.approx(0.13, abs=0.002), pytest.approx(0.90, abs=0.002))
    chosen = find_longest_arms(PAPER)
    assert (chosen.d1_m, chosen.d2_m, chosen.fits) == (0.10, 0.50, True)
    assert (chosen.r_rad2ps4, chosen.q_rad2ps4) == (pytest.approx(80), pytest.approx(0.48))


def test_variances_fall_with_the_square_of_the_arm():
    """Eq (27) through (25), for both geometries; in the five the centre's noise counts too."""
    for geometry in ("bench", "five"):
        rig = replace(PAPER, geometry=geometry)
        short, long = evaluate_placement(rig, 0.05, 0.2), evaluate_placement(rig, 0.10, 0.5)
        assert short.r_rad2ps4 / long.r_rad2ps4 == pytest.approx(4)
        assert short.q_rad2ps4 / long.q_rad2ps4 == pytest.approx(6.25)
    assert evaluate_placement(replace(PAPER, geometry="five"), 0.1, 0.5).r_rad2ps4 == pytest.approx((0.8 + 0.12) / 0.01)


def test_no_longer_arm_fits_and_no_shorter_one_is_better():
    chosen = find_longest_arms(PAPER)
    for d1, d2 in ((0.11, 0.5), (0.1, 0.51)):
        assert not evaluate_placement(PAPER, d1, d2).fits
    for d1, d2 in ((0.09, 0.5), (0.1, 0.49), (0.05, 0.2)):
        assert evaluate_placement(PAPER, d1, d2).filtered_rate_sd_radps > chosen.filtered_rate_sd_radps


def test_the_rate_errors_are_the_differences_they_stand_for():
    """sqrt(-F4/d1) with F4 changed by a little bias, and with d1 changed by a little."""
    rate, d1, small = PAPER.fastest_radps, 0.1, 1e-6
    found = evaluate_placement(PAPER, d1, 0.5)
    force = -d1 * rate**2
    assert (np.sqrt(-(force - small) / d1) - rate) / small == pytest.approx(found.rate_per_bias, rel=1e-3)
    assert (np.sqrt(-force / (d1 - small)) - rate) / small == pytest.approx(found.rate_per_arm, rel=1e-3)


@pytest.mark.parametrize(("step", "observation"), [(1.0, 1.0), (1e-4, 3.0), (5.0, 1e-3)])
def test_the_steady_state_is_where_the_filter_settles(step, observation):
    p = 10.0
    for _ in range(200_000):
        p, before = 1 / (1 / (p + step) + 1 / observation), p
        if p == before:
            break
    assert compute_steady_variance(step, observation) == pytest.approx(p, rel=1e-9)


def test_the_filtered_error_is_that_of_the_ekf_on_white_noise():
    """A-1 of the acceptance figures: 1.06 +- 0.05 deg/s at 2020 deg/s."""
    found = evaluate_placement(replace(PAPER, fastest_radps=float(np.deg2rad(2020))), 0.1, 0.5)
    assert np.rad2deg(found.filtered_rate_sd_radps) == pytest.approx(1.06, abs=0.05)
    assert np.rad2deg(found.raw_rate_sd_radps) == pytest.approx(7.25, abs=0.1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"geometry": "six"}, "give one of bench, five"),
        ({"headroom": 1.0}, "headroom 1"),
        ({"range_mps2": 0.0}, "range_mps2 0: give a positive"),
        ({"fastest_radps": float("nan")}, "fastest_radps nan"),
        ({"fastest_radps": 1000.0, "spin_up_s": 10.0}, "an arm of 1 cm already uses"),
        ({"room_m": 0.005}, "no room for it"),
    ],
)
def test_impossible_rigs_are_refused(change, said):
    with pytest.raises(BadParameter, match=said):
        find_longest_arms(replace(PAPER, **change))


@pytest.mark.slow
def test_the_command_writes_a_picture_and_the_rows(call, tmp_path, capsys):
    assert call("spin", "design", "-o", tmp_path / "out", "--json", tmp_path / "rows.json") == 0
    text = capsys.readouterr().out
    assert "F4 reads the whole range at d1 = 0.129 m, F5 at d2 = 0.899 m" in text
    assert (tmp_path / "out" / "spin-design.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((tmp_path / "out" / "spin-design.json").read_text())["rows"]
    assert rows == json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert (rows[0]["d1_m"], rows[0]["d2_m"], rows[0]["fits"]) == (0.1, 0.5, True)
    assert {row["fits"] for row in rows} == {True, False}
    assert call("spin", "design", "-o", tmp_path / "out", "--fastest-degps", "20000") == 2
    assert "larger range" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("room_m", [0.01, 0.03, 0.5])
def test_the_placement_lies_on_its_curves_and_within_its_map(room_m):
    rig = replace(PAPER, room_m=room_m)
    chosen = find_longest_arms(rig)
    for draw, x, y in (
        (draw_radial, chosen.d1_m, None),
        (draw_tangential, chosen.d2_m, None),
        (draw_both, chosen.d1_m, chosen.d2_m),
    ):
        ax = Figure().subplots()
        draw(ax, rig, chosen)
        low, high = ax.get_xlim()
        assert low < x < high
        if y is None:
            assert ax.lines[0].get_xdata()[0] < x
        else:
            assert ax.get_ylim()[0] < y < ax.get_ylim()[1]
