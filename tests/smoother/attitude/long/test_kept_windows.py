"""A run that is stopped between two windows goes on with the next one, and ends with the same bits."""

from collections.abc import MutableMapping
from dataclasses import asdict, replace

import numpy as np
import pytest

from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother.attitude import windows
from stillpoint.smoother.attitude.long.kept_windows import PackedWindow
from stillpoint.smoother.attitude.method import make_graph_reference
from stillpoint.smoother.attitude.params import HANDHELD, PRESETS, GraphParams


@pytest.fixture(scope="module")
def wanted(swings: Recording, windowed: GraphParams) -> Reference:
    return make_graph_reference(swings, windowed).whole()


def make(recording: Recording, params: GraphParams, kept: MutableMapping[str, PackedWindow]) -> Reference:
    return make_graph_reference(recording, params, kept=kept).whole()


def require_same(found: Reference, wanted: Reference) -> None:
    np.testing.assert_equal(asdict(found), asdict(wanted))


class Stopped(Exception):
    """Stands for the end of the process."""


class StopsAfter(dict):
    """Keeps so many windows and then stops the run."""

    def __init__(self, count):
        super().__init__()
        self.count = count

    def __setitem__(self, name, window):
        super().__setitem__(name, window)
        if len(self) == self.count:
            raise Stopped


@pytest.mark.slow
@pytest.mark.parametrize("solved", [1, 2, 3])
def test_a_stopped_run_goes_on_with_the_next_window(
    swings: Recording, windowed: GraphParams, wanted: Reference, solved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = StopsAfter(solved)
    with pytest.raises(Stopped):
        make(swings, windowed, kept)
    times, solve_window = [], windows._solve_window
    monkeypatch.setattr(windows, "_solve_window", lambda *given: times.append(given) or solve_window(*given))
    require_same(make(swings, windowed, dict(kept)), wanted)
    assert wanted.diagnostics["windows"] == 3
    assert len(times) == 3 - solved


@pytest.mark.slow
def test_windows_of_other_evidence_or_settings_are_not_used(swings: Recording, windowed: GraphParams) -> None:
    kept: dict[str, PackedWindow] = {}
    make(swings, windowed, kept)
    assert len(kept) == 3
    narrower = replace(windowed, magnetic=replace(windowed.magnetic, sd_ut=3.0))
    require_same(make(swings, narrower, kept), make(swings, narrower, {}))
    assert len(kept) == 6
    imu = swings.require_imu()
    louder = replace(swings, imu=replace(imu, gyro_b_radps=imu.gyro_b_radps * 1.001))
    require_same(make(louder, windowed, kept), make(louder, windowed, {}))
    assert len(kept) == 9


def test_one_window_is_not_kept(swings: Recording) -> None:
    kept: dict[str, PackedWindow] = {}
    make(swings, HANDHELD, kept)
    assert not kept


@pytest.mark.slow
def test_windows_of_a_drive_with_satellites_come_back() -> None:
    """Here a window also holds place, velocity and doubtful fixes."""
    drive = simulate("car", minutes=3)
    vehicle = PRESETS["vehicle"]
    params = replace(vehicle, keys=replace(vehicle.keys, window_s=90.0, overlap_s=20.0))
    kept = StopsAfter(1)
    with pytest.raises(Stopped):
        make(drive, params, kept)
    found = make(drive, params, dict(kept))
    assert found.position_n_m is not None
    require_same(found, make(drive, params, {}))
