"""``stillpoint stream`` of a spinning body: text in, text out, and what does not go together."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spins import CONSTANT

from stillpoint.datasets import BadParameter, Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.spin import BENCH, FIVE_ACCELEROMETERS
from stillpoint.filters import SpinStream, Stream, estimate
from stillpoint.filters.saved import from_plain, to_plain
from stillpoint.filters.table import SPINS
from stillpoint.scripts.streaming.lines import Lines, make_spin_layout
from stillpoint.scripts.streaming.pipe import Counts, run_pipe


def bench_with_glitches() -> Recording:
    return simulate("spin-constant", seed=2, minutes=0.02, sensor="glitch")


def as_text(recording: Recording, form: str) -> bytes:
    lines = ["t_ns,a1,a2"] if form == "csv" else []
    for t_ns, (a1, a2) in zip(recording.spin.t_ns.tolist(), recording.spin.accel_mps2.tolist(), strict=True):
        lines.append(f"{t_ns},{a1!r},{a2!r}" if form == "csv" else json.dumps({"t_ns": t_ns, "a1": a1, "a2": a2}))
    return ("\n".join(lines) + "\n").encode()


def through(text: bytes, streams: dict[str, SpinStream]) -> tuple[Counts, list[dict]]:
    target = io.StringIO()
    passed = run_pipe(streams, io.BytesIO(text), target, make_spin_layout(2, 0))
    return passed, [json.loads(line) for line in target.getvalue().splitlines()]


@pytest.mark.parametrize("form", ["csv", "ndjson"])
def test_what_is_said_is_the_batch_run_to_the_last_bit(form: str) -> None:
    recording = bench_with_glitches()
    _, said = through(as_text(recording, form), {name: SpinStream(name, BENCH, CONSTANT) for name in SPINS})
    for name in SPINS:
        batch, own = estimate(recording, name, CONSTANT), [one for one in said if one["estimator"] == name]
        for field in ("t_ns", "angle_rad", "rate_radps", "angle_sd_rad", "rate_sd_radps", "ready"):
            assert [one[field] for one in own] == getattr(batch, field).tolist()
        innovations = np.array([one["innovation"] for one in own], dtype=np.float64)  # null becomes NaN
        if batch.innovation is not None:
            assert np.array_equal(innovations, batch.innovation[:, 0], equal_nan=True)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", SPINS)
def test_a_state_kept_as_text_goes_on_bit_for_bit(name: str, precision: str) -> None:
    def new(saved=None) -> SpinStream:
        return SpinStream(name, BENCH, CONSTANT, precision, saved)

    rows = as_text(bench_with_glitches(), "csv").splitlines(keepends=True)
    for cut in (4, 150):  # while it is starting, and later
        first = new()
        _, whole = through(b"".join(rows), {name: new()})
        _, head = through(b"".join(rows[:cut]), {name: first})
        again = new(from_plain(json.loads(json.dumps(to_plain(first.save()))), new().save()))
        _, tail = through(b"".join([rows[0], *rows[cut:]]), {name: again})
        assert head + tail == whole


def test_bad_lines_are_left_out_and_lost_values_counted(capsys: pytest.CaptureFixture[str]) -> None:
    text = b"t_s,a1,a2\n0,-124,0\n0.004,-124\n0.008,,0\nx,-124,0\n0.012,-200,0\n0.012,-124,0\n"
    stream = SpinStream("roll-ekf", BENCH)
    passed, said = through(text, {"roll-ekf": stream})
    assert (passed.n_samples, passed.n_malformed, len(said)) == (4, 2, 4)
    counts = stream.counts
    assert (counts["n_lost"], counts["n_saturated"], counts["n_out_of_order"], counts["n_no_square"]) == (1, 1, 1, 2)
    assert "line 3: it has 2 values" in capsys.readouterr().err


def test_the_columns_are_those_of_the_geometry_in_its_order() -> None:
    lines = Lines(make_spin_layout(len(FIVE_ACCELEROMETERS.accel_axis_b), len(FIVE_ACCELEROMETERS.gyro_axis_b)))
    with pytest.raises(BadParameter, match=r"not a5, g2; give t_ns or t_s, a1, .* a5 \(m/s\^2\), g1, g2 \(rad/s\)"):
        lines.read(b"t_s,a1,a2,a3,a4,g1\n")
    assert lines.read(b"g2,g1,t_s,a5,a4,a3,a2,a1,angle\n") is None
    assert lines.ignored == ("angle",)
    assert lines.read(b"7,6,1,5,4,3,2,1,0\n") == (10**9, (1.0, 2.0, 3.0, 4.0, 5.0), (6.0, 7.0))


def test_the_command_with_a_geometry_of_ones_own_saves_and_goes_on(
    feed: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    rig, state = tmp_path / "rig.toml", tmp_path / "state.json"
    rig.write_text("accel_r_m = [[0, 0, 0.2], [0, 0.5, 0]]\naccel_axis = [[0, 0, 1], [0, 0, 1]]\nfixed_axis = true\n")
    options = ["-e", "roll-obs", "--geometry", rig]
    _, first, _ = feed("t_s,a1,a2\n0,-180,0\n", *options, "--save", state)
    assert json.loads(first)["rate_radps"] == pytest.approx(30)  # sqrt(180 / 0.2)
    _, second, _ = feed("t_s,a1,a2\n0.5,-180,0\n", *options, "--resume", state)
    assert json.loads(second)["angle_rad"] == pytest.approx(15)
    rig.write_text(rig.read_text().replace("0.2", "0.3"))
    code, _, err = feed("", *options, "--resume", state)
    assert code == 2
    assert "was saved with other options" in err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["-e", "cf,roll-ekf"], "by themselves"),
        (["-e", "cf", "--geometry", "five"], "--geometry, --d1-m"),
        (["-e", "roll-ekf", "--declination", "4"], "follows a spin"),
        (["-e", "roll-ekf", "--heading", "gps-course"], "has no heading"),
        (["-e", "roll-ekf", "--foxglove", "0", "run.mcap"], "use stillpoint estimate"),
        (["-e", "roll-ekf", "--geometry", "six"], "no preset 'six'"),
    ],
)
def test_what_does_not_go_together_gives_one_line_error(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from stillpoint.scripts.main import main

    with pytest.raises(SystemExit) as ended:
        main(["stream", *options])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_a_state_of_attitude_is_not_one_of_roll() -> None:
    with pytest.raises(BadParameter, match="not one of the present roll-ekf"):
        from_plain(to_plain(Stream("cf").save()), SpinStream("roll-ekf", BENCH).save())
