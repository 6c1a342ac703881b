"""``python -m stillpoint.scripts.pages.spin_failures``: print what single faults do to each spin estimator.

A trial of 30 s at constant speed with little radial noise; the filters are told the noise of the experiment, as in
``stillpoint experiment spin-constant``. Prints a table for the page: largest angle error and RMSE of the rate.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stillpoint.datasets.recording import Floats, Recording, Spin
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.simulate.spin_sensor import make_white_noise
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import estimate
from stillpoint.scoring.spin import score_roll
from stillpoint.scripts.program import run_program
from stillpoint.smoother import reference
from stillpoint.studies.papers.spin.study import CONSTANT, FILTERS, make_settings

_QUIET = make_white_noise("quiet", 0.06, 0.13, 0.08)  # the bench of tests/filters/spin/test_guarded.py
_AT, _LONG = 3000, 250  # samples: where the fault is, and how long it lasts when it lasts


def _change_nothing(accel: Floats) -> None:
    """Return the trial unchanged."""


def _add_tangential_bias(accel: Floats) -> None:
    accel[:, 1] += 0.4


def _add_radial_bias(accel: Floats) -> None:
    accel[:, 0] += 0.1


def _drop_samples(accel: Floats) -> None:
    accel[_AT, 0] = np.nan


def _set_zeros(accel: Floats) -> None:
    accel[_AT : _AT + 3] = 0.0


def _freeze_sensor(accel: Floats) -> None:
    accel[_AT : _AT + _LONG, 0] = accel[_AT, 0]


def _kill_start(accel: Floats) -> None:
    accel[:20] = 0.0


def _spoil_start(accel: Floats) -> None:
    accel[0, 0] += 60.0


_FAULTS: dict[str, Callable[[Floats], None]] = {
    "nothing": _change_nothing,
    "F5 off by 0.4 m/s² (40 mg)": _add_tangential_bias,
    "F4 off by 0.1 m/s² (10 mg)": _add_radial_bias,
    "one NaN": _drop_samples,
    "three samples read zero": _set_zeros,
    "F4 stuck for 1 s": _freeze_sensor,
    "the first sample is a glitch": _spoil_start,
    "F4 and F5 read zero for the first 80 ms": _kill_start,
}


def main() -> None:
    """Print the table."""
    print(f"| fault | {' | '.join(FILTERS)} | smoother |")
    print("|---" * (len(FILTERS) + 2) + "|")
    for name, spoil in _FAULTS.items():
        recording = _spoil_trial(simulate("spin-constant", seed=0, sensor=_QUIET), spoil)
        smoothed = reference(recording)
        assert isinstance(smoothed, SpinReference)
        made: list[Estimate | SpinReference] = [
            *(estimate(recording, each, make_settings(CONSTANT, method, False)) for method, each in FILTERS.items()),
            smoothed,
        ]
        print(f"| {name} | {' | '.join(_format_cell(recording, one) for one in made)} |")


def _spoil_trial(recording: Recording, spoil: Callable[[Floats], None]) -> Recording:
    """Return the recording with the accelerometers' values (N, k) spoiled."""
    spin = recording.spin
    assert spin is not None
    accel = spin.accel_mps2.copy()
    spoil(accel)
    return replace(recording, spin=Spin(spin.t_ns, accel, spin.gyro_radps, spin.geometry))


def _format_cell(recording: Recording, made: Estimate | SpinReference) -> str:
    """Return the largest error of the angle in deg and the RMSE of the rate in deg/s."""
    assert recording.roll_truth is not None
    found = score_roll(made, recording.roll_truth)
    return f"{found.angle_max_deg:.1f}, {found.rate_rmse_degps:.2f}"


if __name__ == "__main__":
    run_program(main)
