"""The doctor on a spinning body: planted faults are found, clean trials are clean."""

from dataclasses import replace

import numpy as np
import pytest

from stillpoint.datasets.doctor import diagnose
from stillpoint.datasets.simulate import SIMULATIONS, simulate
from stillpoint.datasets.spin import FIVE_ACCELEROMETERS

pytestmark = pytest.mark.filterwarnings("error")
NO_RESTS = np.empty((0, 2), np.int64)


@pytest.fixture(scope="module")
def clean():
    return simulate("spin-constant", 0, minutes=0.2)


def with_spin(recording, **changes):
    return replace(recording, spin=replace(recording.spin, **changes))


def codes(recording):
    return set(diagnose(recording, NO_RESTS).codes("error", "warning"))


@pytest.mark.parametrize(
    ("kind", "sensor"),
    [(kind, name) for kind in SIMULATIONS if kind.startswith("spin") for name in SIMULATIONS[kind].sensors],
)
def test_clean_trials_are_clean(kind, sensor):
    for seed in range(3):
        assert codes(simulate(kind, seed, minutes=0.2, sensor=sensor)) - {"spin-lost"} == set()


@pytest.mark.parametrize(
    ("column", "factor", "found"),
    [
        (0, -1.0, "spin-radial-sign"),
        (0, 1 / 9.80665, "spin-scale"),
        (0, 1.06, "spin-scale"),
        (1, -1.0, "spin-tangential-sign"),
    ],
)
def test_a_wrong_sign_or_unit_is_found(clean, column, factor, found):
    accel = clean.spin.accel_mps2.copy()
    accel[:, column] *= factor
    assert codes(with_spin(clean, accel_mps2=accel)) == {found}


def test_lost_and_saturated_values_are_counted(clean):
    accel = clean.spin.accel_mps2.copy()
    accel[100:200, 1] = np.nan
    accel[300:305, 0] = -clean.spin.geometry.accel_range_mps2[0]
    diagnosis = diagnose(with_spin(clean, accel_mps2=accel), NO_RESTS)
    messages = {finding.code: (finding.severity, finding.message) for finding in diagnosis.findings}
    assert messages["spin-missing"] == ("warning", "spin: values that hold no value: 100 of accelerometer 2")
    assert messages["spin-saturated"][0] == "fact"
    assert "5 of accelerometer 1" in messages["spin-saturated"][1]


def test_a_geometry_that_tells_nothing_is_an_error(clean):
    loose = replace(clean.spin.geometry, fixed_axis=False)
    assert codes(with_spin(clean, geometry=loose)) == {"spin-geometry"}


def test_an_accelerometer_out_of_the_plane_is_named():
    """Four more than are needed: the spin is fixed, and eq (2) is broken all the same."""
    flight = simulate("spin-flight", 0, minutes=0.1)
    extra = np.array([[0.02, 0, 0.1], [0, 0.1, 0], [0, 0, 0.1], [0.1, 0, 0]])
    geometry = replace(
        FIVE_ACCELEROMETERS,
        accel_r_b_m=np.vstack([FIVE_ACCELEROMETERS.accel_r_b_m, extra]),
        accel_axis_b=np.vstack([FIVE_ACCELEROMETERS.accel_axis_b, np.eye(3)[[2, 0, 0, 2]]]),
        accel_range_mps2=None,
    )
    accel = np.column_stack(
        [flight.spin.accel_mps2, np.random.default_rng(0).standard_normal((len(flight.spin.t_ns), 4))]
    )
    assert "spin-misplaced" in codes(with_spin(flight, accel_mps2=accel, geometry=geometry))


def test_nothing_but_lost_values_is_survived(clean):
    nothing = np.full_like(clean.spin.accel_mps2, np.nan)
    assert codes(with_spin(clean, accel_mps2=nothing)) == {"spin-missing"}


def test_equal_samples_are_a_fault_in_a_spin_and_none_at_rest(clean):
    accel = clean.spin.accel_mps2.copy()
    accel[1000:1200] = accel[1000]
    assert codes(with_spin(clean, accel_mps2=accel)) == {"spin-accel-frozen"}
    assert codes(with_spin(clean, accel_mps2=accel - accel[1000])) & {"spin-accel-frozen"} == set()


def test_unknown_lever_arms_are_a_warning(clean):
    geometry = replace(clean.spin.geometry, accel_r_b_m=np.full((2, 3), np.nan))
    diagnosis = diagnose(with_spin(clean, geometry=geometry), NO_RESTS)
    assert diagnosis.codes("warning") == ("spin-geometry",)
