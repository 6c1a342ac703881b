"""``reference`` by name, its settings, and the verb that writes references."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillpoint.datasets import BadParameter, Imu, Recording, read, write
from stillpoint.datasets.mcap.store import sha256
from stillpoint.datasets.settings import list_names
from stillpoint.datasets.simulate import simulate
from stillpoint.scripts.pages.settings_pages import refresh_tables
from stillpoint.smoother import METHODS, reference
from stillpoint.smoother.attitude.params import PRESETS
from stillpoint.smoother.redistribution import RedistributionParams
from stillpoint.smoother.rest import RestParams


@pytest.fixture(scope="module")
def recording():
    return simulate("phone-3", seed=2, minutes=1.6)


@pytest.fixture
def folder(tmp_path, recording):
    write(tmp_path / "good.mcap", recording)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_method_says_which_it_is_and_with_what_settings(recording, method):
    made = reference(recording, method)
    assert made.method == method
    assert made.name == recording.name
    assert made.params["rest"]["window_s"] == RestParams().window_s
    np.testing.assert_array_equal(made.t_ns, recording.imu.t_ns)
    json.dumps([made.params, made.diagnostics])


def test_a_mapping_and_the_settings_object_give_the_same(recording):
    given = RedistributionParams(rest=RestParams(min_rest_s=2.5), prior_returns=3.0)
    by_name = reference(recording, "redistribution", {"rest.min_rest_s": "2.5", "prior_returns": 3})
    by_object = reference(recording, "redistribution", given)
    np.testing.assert_array_equal(by_name.q_nb, by_object.q_nb)
    np.testing.assert_array_equal(by_name.cov_b_rad2, by_object.cov_b_rad2)
    assert by_name.params == by_object.params


@pytest.mark.slow
def test_the_same_recording_gives_the_same_bits(recording):
    one, two = reference(recording), reference(recording)
    np.testing.assert_array_equal(one.q_nb, two.q_nb)
    np.testing.assert_array_equal(one.cov_b_rad2, two.cov_b_rad2)


@pytest.mark.parametrize(
    ("method", "name"),
    [(method, name) for method in ("graph", "redistribution") for name in list_names(METHODS[method].defaults)],
)
def test_every_setting_can_be_changed_by_its_name(method, name):
    with pytest.raises(BadParameter, match=name.rpartition(".")[2]):
        reference(None, method, {name: "1e9"})  # out of every range, so that the setting is known to be reached


@pytest.mark.parametrize(
    ("method", "params", "said"),
    [
        ("redistributoin", None, "did you mean 'redistribution'"),
        ("magic", None, "there are graph, redistribution"),
        ("redistribution", {"rest.windows": 1}, "did you mean 'rest.window_s'"),
        ("redistribution", {"tilt_gate_rad": 1}, "did you mean 'returns.tilt_gate_rad'"),
        ("redistribution", {"rest": 1}, "no setting 'rest'"),
        ("redistribution", {"rest.window_s": "long"}, "give a number"),
        ("redistribution", {"rest.window_s": 1000}, "give a number from 0.3 to 10"),
        ("redistribution", RestParams(), "give its RedistributionParams"),
    ],
)
def test_wrong_names_and_values_are_refused_with_the_nearest(recording, method, params, said):
    with pytest.raises(BadParameter, match=said):
        reference(recording, method, params)


@pytest.mark.slow
def test_the_verb_writes_what_reference_gives(call, folder, recording, capsys):
    assert call("reference", folder, "-o", folder / "out", "--json", folder / "r.json") == 0
    made = read(folder / "out" / "good.reference.mcap")
    np.testing.assert_array_equal(made.q_nb, reference(recording).q_nb)
    assert made.made_from == {"good.mcap": sha256(folder / "good.mcap")}
    (row,) = json.loads((folder / "r.json").read_text())["rows"]
    assert row["error"] is None
    assert sum(one["accepted"] for one in row["returns"]) > 0
    assert row["heading_sd_deg"] == pytest.approx(np.rad2deg(made.heading_sd_rad))
    assert row["diagnostics"]["iterations"] > 0
    assert "good" in capsys.readouterr().out


@pytest.mark.slow
def test_the_verb_takes_several_methods_and_settings(call, folder):
    names = ",".join(METHODS)
    code = call("reference", folder / "good.mcap", "-o", folder, "--method", names, "--set", "rest.min_rest_s=2")
    assert code == 0
    for name in METHODS:
        made = read(folder / f"good.{name}.reference.mcap")
        assert made.method == name
        assert made.params["rest"]["min_rest_s"] == 2.0


def test_settings_come_on_top_of_the_preset(call, folder):
    words = ("--preset", "bench", "--set", "motion.velocity_sd_mps=0.4", "--set", "keys.moving_s=0.2")
    assert call("reference", folder / "good.mcap", "-o", folder / "out", *words) == 0
    motion = read(folder / "out" / "good.reference.mcap").params["motion"]
    assert (motion["position_sd_m"], motion["velocity_sd_mps"]) == (PRESETS["bench"].motion.position_sd_m, 0.4)
    assert motion["position_sd_m"] != PRESETS["handheld"].motion.position_sd_m


def restless():
    t_ns = np.arange(2000) * 10_000_000
    gyro = np.random.default_rng(0).normal(0, 1, (2000, 3))
    return Recording("restless", imu=Imu(t_ns, gyro, gyro + np.array([0, 0, 9.81])))


def test_a_refused_recording_is_named_and_the_others_are_made(call, folder, capsys):
    write(folder / "restless.mcap", restless())
    words = ("--method", "redistribution", "--json", "-")
    assert call("reference", folder, "-o", folder / "out", *words) == 2
    rows = {row["recording"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["good"]["error"] is None
    assert "no rest" in rows["restless"]["error"]
    assert [path.name for path in (folder / "out").iterdir()] == ["good.reference.mcap"]


@pytest.mark.parametrize(
    ("tokens", "said"),
    [
        (["--method", "nope"], "no reference method 'nope'"),
        (["--set", "rest.window_s"], "write NAME=VALUE"),
        (["--set", "rest.window=2"], "did you mean 'rest.window_s'"),
        (["--jobs", "0"], "give 1 or more"),
        (["--preset", "phoen"], "did you mean 'phone'"),
        (["--preset", "vehicle", "--method", "redistribution"], "is for the method graph, not redistribution"),
        (["--preset", "vehicle", "--method", "graph,redistribution"], "is for the method graph, not redistribution"),
        (["--preset", "vehicle", "--set", "motion.position_sd_m=-1"], "give a number from"),
    ],
)
def test_errors_of_the_verb_are_one_line(call, folder, capsys, tokens, said):
    assert call("reference", folder / "good.mcap", "-o", folder / "out", *tokens) == 2
    message = capsys.readouterr().err.strip()
    assert said in message
    assert "\n" not in message


def test_one_refused_recording_gives_one_line_error(call, tmp_path, capsys):
    write(tmp_path / "restless.mcap", restless())
    assert call("reference", tmp_path / "restless.mcap", "-o", tmp_path, "--method", "redistribution") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("stillpoint: restless: no rest")


def of_spin(name, sign=1.0):
    made = simulate("spin-constant", seed=0, sensor="white", minutes=0.1)
    accel = made.spin.accel_mps2 * np.array([sign, 1.0])
    return replace(made, name=name, spin=replace(made.spin, accel_mps2=accel))


def test_settings_without_a_method_are_those_of_the_streams(call, tmp_path, folder, capsys):
    spins = folder / "spins"
    spins.mkdir()
    write(spins / "a.mcap", of_spin("a"))
    assert call("reference", spins, "-o", tmp_path, "--set", "encoder.use=true") == 0
    assert read(tmp_path / "a.reference.mcap").params["encoder"]["use"] is True
    assert call("reference", spins, "-o", tmp_path, "--set", "encoder.usee=true") == 2
    assert "roll-graph: no setting 'encoder.usee'; did you mean 'encoder.use'" in capsys.readouterr().err
    # Beside a recording of attitude they are those of the method graph, as before.
    assert call("reference", folder, "-o", tmp_path, "--set", "encoder.use=true") == 2
    assert "stillpoint: graph: no setting 'encoder.use'" in capsys.readouterr().err


@pytest.mark.slow
def test_a_refused_spin_is_named_with_its_method(call, tmp_path, folder, capsys):
    write(folder / "bad.mcap", of_spin("bad", sign=-1.0))
    write(folder / "fine.mcap", of_spin("fine"))
    assert call("reference", folder, "-o", tmp_path / "out", "--json", tmp_path / "r.json") == 2
    assert "not made (roll-graph): bad: the squared rate is negative" in " ".join(capsys.readouterr().out.split())
    rows = {row["recording"]: row["method"] for row in json.loads((tmp_path / "r.json").read_text())["rows"]}
    assert rows == {"bad": "roll-graph", "fine": "roll-graph", "good": "graph"}


def test_two_recordings_of_one_name_do_not_overwrite_each_other(call, folder, recording, capsys):
    (folder / "more").mkdir()
    write(folder / "more" / "good.mcap", recording)
    assert call("reference", folder, "-o", folder / "out") == 2
    assert "two recordings have this name" in capsys.readouterr().err


def test_the_document_is_up_to_date():
    text = (Path(__file__).parents[2] / "docs" / "reference-settings.md").read_text(encoding="utf-8")
    assert refresh_tables(text) == text, "run python -m stillpoint.scripts.pages.settings_pages"
    assert list_names(RedistributionParams())[0] in text
    for method in METHODS:
        assert f"| `{method}` |" in text
