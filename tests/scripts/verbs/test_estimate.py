"""``stillpoint estimate``: files in, files and one table out; compiled code outlives the process."""

import json
import re
import subprocess
import sys
from ast import literal_eval
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets import read, write
from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.mcap.store import sha256
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import ESTIMATORS
from stillpoint.filters import estimate as run
from stillpoint.scripts.verbs.estimate import estimate

ALL_OF_THEM = """
import numpy as np
from stillpoint.datasets import Imu, Info, Recording
from stillpoint.datasets.recording import Spin
from stillpoint.datasets.spin import BENCH
from stillpoint.filters import ESTIMATORS, Stream, estimate
from stillpoint.filters.spin.stream import SpinStream
from stillpoint.filters.table import SPINS
t_ns = np.arange(10) * 10_000_000
imu = Imu(t_ns, np.zeros((10, 3)), np.tile([0, 0, 9.81], (10, 1)))
spin = Spin(t_ns, np.tile([-100.0, 0.0], (10, 1)), np.empty((10, 0)), BENCH)
misses = {}
for name, entry in ESTIMATORS.items():
    if not entry.is_peer:
        estimate(Recording("x", imu, spin=spin, info=Info(units_unchecked=True)), name)
        if name in SPINS:
            SpinStream(name, BENCH).update(0, (-100.0, 0.0))
        else:
            Stream(name).update(0, (0, 0, 0), (0, 0, 9.81))
        for part in (entry.start, entry.step, entry.run):
            misses[name] = misses.get(name, 0) + sum(part.stats.cache_misses.values())
print(misses)
"""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for seed in (0, 1):
        recording = simulate("phone-1", seed=seed, minutes=0.6)
        write(folder / f"{recording.name}.mcap", recording)
    return folder


@pytest.mark.slow
def test_one_file_per_recording_and_estimator_that_names_its_source(recordings: Path, tmp_path: Path) -> None:
    facts = tmp_path / "facts.json"
    code = estimate(
        [recordings],
        estimators="acc,cf",
        out=tmp_path,
        set_=["cf.omega0_radps=0.3"],
        json=str(facts),
    )
    assert code == 0
    rows = json.loads(facts.read_text())["rows"]
    assert [row["estimator"] for row in rows] == ["acc", "cf"] * 2
    for row in rows:
        source = recordings / f"{row['recording']}.mcap"
        kept = read(row["file"])
        assert Path(row["file"]).name == f"{row['recording']}.{row['estimator']}.estimate.mcap"
        assert kept.made_from == {source.name: sha256(source)}
        fresh = run(read(source), row["estimator"], row["params"])
        assert (kept.q_nb == fresh.q_nb).all()
        assert kept.params == row["params"] == fresh.params
    assert rows[1]["params"]["omega0_radps"] == 0.3


def test_the_command_runs_single_precision_and_peers(recordings: Path, tmp_path: Path) -> None:
    estimate([recordings / "phone-1-seed0.mcap"], estimators="cf", out=tmp_path, precision="single")
    kept = read(tmp_path / "phone-1-seed0.cf.estimate.mcap")
    assert (kept.q_nb.astype(np.float32) == kept.q_nb).all()
    assert kept.diagnostics["precision"] == "single"
    assert 0 < kept.diagnostics["off_double_rms_deg"] < kept.diagnostics["off_double_max_deg"] < 0.01
    with pytest.raises(BadParameter, match="vqf"):
        estimate([recordings], estimators="cf,vqf", out=tmp_path, precision="single")


@pytest.mark.parametrize(
    ("estimators", "settings", "says"),
    [
        ("cff", [], "did you mean 'cf'"),
        ("cf", ["omega0_radps=1"], "ESTIMATOR.NAME=VALUE"),
        ("cf", ["cf.omega=1"], "omega0_radps"),
        ("cf", ["cf.omega0_radps=fast"], "0.0001 to 100"),
        ("cf", ["acc.kappa=1"], "not among"),
    ],
)
def test_a_wrong_option_is_refused_before_any_work(
    recordings: Path, tmp_path: Path, estimators: str, settings: list[str], says: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises(BadParameter, match=says):
        estimate([recordings], estimators=estimators, out=out, set_=settings)
    assert not out.exists()


@pytest.mark.parametrize(("verb", "whole"), [("estimate", True), ("stream", False)])
def test_the_help_names_every_estimator_it_takes(call, verb: str, whole: bool, capsys) -> None:
    assert call(verb, "--help") == 0
    words = set(re.findall(r"[a-z-]+", capsys.readouterr().out))
    assert {name for name, entry in ESTIMATORS.items() if whole or not entry.is_peer} <= words


@pytest.mark.slow
def test_the_next_process_compiles_nothing() -> None:
    exec(ALL_OF_THEM, {})
    following = subprocess.run([sys.executable, "-c", ALL_OF_THEM], capture_output=True, text=True, check=True)
    misses = literal_eval(following.stdout)
    assert set(misses) == {name for name, entry in ESTIMATORS.items() if not entry.is_peer}
    assert not any(misses.values())
