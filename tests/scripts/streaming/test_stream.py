"""``stillpoint stream``: text in, text out, ends, and the replay to Foxglove."""

import fcntl
import io
import json
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np
import pytest
from motions import untidy
from quick import mark_slow_except

from stillpoint.datasets import BadParameter, Recording, write
from stillpoint.datasets.simulate import simulate
from stillpoint.filters import Stream, estimate
from stillpoint.filters.saved import from_plain, to_plain
from stillpoint.filters.table import ESTIMATORS, Estimator
from stillpoint.scripts.shared.estimator_choice import choose_runs
from stillpoint.scripts.streaming.heading_watch import HeadingWatch
from stillpoint.scripts.streaming.latency import Latency
from stillpoint.scripts.streaming.lines import Lines, Malformed
from stillpoint.scripts.streaming.pipe import Counts, run_pipe
from stillpoint.scripts.streaming.streams import describe_run, make_attitude_stream, open_streams, save_streams

COMMAND = [sys.executable, "-c", "from stillpoint.scripts.main import main; main()", "stream"]
Feed = Callable[..., tuple[int, str, str]]
HEADER = "t_ns,gx,gy,gz,ax,ay,az,mx,my,mz"
AT_REST = "0,0,0,0,0,9.81,0,20,-44"
FILTERS = [name for name, entry in ESTIMATORS.items() if isinstance(entry, Estimator)]


def as_text(recording: Recording, form: str) -> bytes:
    """A recording as lines: the field on the line of the first IMU sample that it is not after."""
    imu, mag = recording.require_imu(), recording.mag
    at = {int(k): row for row, k in enumerate(np.searchsorted(imu.t_ns, mag.t_ns))}
    lines = [HEADER] if form == "csv" else []
    for k, t_ns in enumerate(imu.t_ns.tolist()):
        numbers = [*imu.gyro_b_radps[k].tolist(), *imu.accel_b_mps2[k].tolist()]
        field = mag.mag_b_ut[at[k]].tolist() if k in at else None
        if form == "csv":
            lines.append(",".join([str(t_ns), *map(repr, numbers), *(map(repr, field) if field else ["", "", ""])]))
        else:
            names = HEADER.split(",") if field else HEADER.split(",")[:7]
            lines.append(json.dumps(dict(zip(names, [t_ns, *numbers, *(field or [])], strict=True))))
    return ("\n".join(lines) + "\n").encode()


def through(text: bytes, *names: str, **streams: Stream) -> tuple[Counts, list[dict]]:
    target = io.StringIO()
    passed = run_pipe({name: Stream(name) for name in names} | streams, io.BytesIO(text), target)
    return passed, [json.loads(line) for line in target.getvalue().splitlines()]


@pytest.mark.parametrize("form", ["csv", "ndjson"])
def test_what_is_said_is_the_batch_run_to_the_last_bit(form: str) -> None:
    recording = untidy()
    passed, said = through(as_text(recording, form), "cf", "kf-axis")
    for name in ("cf", "kf-axis"):
        batch, own = estimate(recording, name), [one for one in said if one["estimator"] == name]
        assert ([one["t_ns"] for one in own] == batch.t_ns).all()
        assert (np.array([one["q_nb"] for one in own]) == batch.q_nb).all()
        assert [one["ready"] for one in own] == batch.ready.tolist()
    axis = [one for one in said if one["estimator"] == "kf-axis"]
    assert len(axis[-1]["cov_b_rad2"]) == 9
    assert None in axis[0]["innovation"]  # NaN is no JSON
    assert passed.n_samples == len(recording.require_imu().t_ns) == passed.whole.n


def test_bad_lines_are_named_and_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{k},{AT_REST}" for k in range(0, 90_000_000, 10_000_000)]
    bad = ["1,2", "x," + AT_REST, "50000000,zero,0,0,0,0,9.81,0,20,-44", "\xff\xfe"]
    text = "\n".join([HEADER, *rows[:5], "", *bad[:3], *rows[5:]]).encode() + b"\n\xff\xfe\n"
    passed, said = through(text, "cf")
    assert (passed.n_samples, passed.n_malformed, len(said)) == (9, 4, 9)
    said_by = capsys.readouterr().err.splitlines()
    assert [re.search(r"line (\d+)", line)[1] for line in said_by] == ["8", "9", "10", "15"]
    assert "has 2 values, the header 10 names" in said_by[0]
    assert "gx is 'zero', not a number" in said_by[2]


def test_many_bad_lines_do_not_flood(capsys: pytest.CaptureFixture[str]) -> None:
    passed, _ = through((HEADER + "\n" + "nothing\n" * 500).encode(), "cf")
    assert passed.n_malformed == 500
    assert len(capsys.readouterr().err.splitlines()) == 20


@pytest.mark.parametrize(
    ("first", "says"),
    [
        ("time,gx,gy,gz,ax,ay,az", "not t_ns"),
        ("t_ns,gx,gy,gz,ax,ay", "not az"),
        ('{"t_s": 0, "gx": 0}', "not gy, gz, ax, ay, az"),
        ("0,0,0,0,0,0,9.81", "names 0, 0, 0"),
    ],
)
def test_a_first_line_that_names_no_samples_is_refused(first: str, says: str) -> None:
    with pytest.raises(BadParameter, match=says) as caught:
        through((first + "\n").encode(), "cf")
    assert "give t_ns or t_s, gx, gy, gz (rad/s)" in str(caught.value)


def test_fields_beyond_those_known_are_named_once(capsys: pytest.CaptureFixture[str]) -> None:
    through(f"{HEADER},temp_c\n0,{AT_REST},21\n10000000,{AT_REST},22\n".encode(), "cf")
    assert capsys.readouterr().err == "stillpoint: not used: temp_c\n"


def test_seconds_missing_numbers_courses_and_a_byte_order_mark() -> None:
    lines = Lines()
    assert lines.read(b"\xef\xbb\xbft_s,gx,gy,gz,ax,ay,az,mx,my,mz,course_rad,speed_mps\r\n") is None
    sample = lines.read(b"1.25,1,2,3,4,5,,,,,0.5,1.5\r\n")
    assert sample.t_ns == 1_250_000_000
    assert sample.gyro_b_radps == (1.0, 2.0, 3.0)
    assert sample.mag_b_ut is None
    assert np.isnan(sample.accel_b_mps2[2])
    assert sample.course == (0.5, 1.5)
    assert np.isnan(lines.read(b"1.3,1,2,3,4,5,6,7,,9,,\n").mag_b_ut[1])
    for line in (b"nan,1,2,3,4,5,6,7,8,9,,\n", b"1e300,1,2,3,4,5,6,7,8,9,,\n"):
        with pytest.raises(Malformed, match="t_s"):
            lines.read(line)


@pytest.mark.parametrize("value", ["2.5", "true", '"now"', "1e30"])
def test_a_time_that_is_no_whole_number_of_ns_is_malformed(value: str) -> None:
    lines = Lines()
    lines.read(b'{"t_ns":0,"gx":0,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.8}')
    with pytest.raises(Malformed, match="t_ns"):
        lines.read(f'{{"t_ns":{value},"gx":0,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.8}}'.encode())


@pytest.mark.parametrize("name", mark_slow_except(FILTERS, "cf", "ekf"))
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_state_kept_as_text_goes_on_bit_for_bit(name: str, precision: str) -> None:
    rows = as_text(untidy(), "csv").splitlines(keepends=True)[:600]
    _, whole = through(b"".join(rows), **{name: Stream(name, precision=precision)})
    first = Stream(name, precision=precision)
    _, head = through(b"".join(rows[:301]), **{name: first})
    kept = json.loads(json.dumps(to_plain(first.save())))
    again = Stream(name, precision=precision, saved=from_plain(kept, Stream(name, precision=precision).save()))
    _, tail = through(b"".join([rows[0], *rows[301:]]), **{name: again})
    assert head + tail == whole


def test_a_kept_state_of_another_estimator_is_refused() -> None:
    kept = to_plain(Stream("acc").save())
    with pytest.raises(BadParameter, match="not one of the present cf"):
        from_plain(kept, Stream("cf").save())


@pytest.mark.parametrize("declination_rad", [np.nan, np.inf, 3.2])
def test_a_declination_that_is_no_angle_is_refused(declination_rad: float) -> None:
    for heading in ("mag", "gps-course"):
        with pytest.raises(BadParameter, match="within"):
            Stream("cf", declination_rad=declination_rad, heading=heading)


@pytest.mark.parametrize("line", ["[" * 100_000, '{"t_ns":1,"gx":' + "[" * 900 + "]" * 900 + "}"])
def test_a_line_of_brackets_is_malformed(line: str) -> None:
    lines = Lines()
    lines.read(b'{"t_ns":0,"gx":0,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.8}')
    with pytest.raises(Malformed) as caught:
        lines.read(line.encode())
    assert len(str(caught.value)) < 100


@pytest.mark.parametrize(("header", "says"), [("t_ns", "t_ns"), ("t_s", "t_s"), ("t_s,t_ns", "t_ns and t_s")])
def test_a_row_without_a_time_names_the_columns_that_it_is_missing_in(header: str, says: str) -> None:
    lines = Lines()
    lines.read(f"{header},gx,gy,gz,ax,ay,az".encode())
    with pytest.raises(Malformed, match=f"^{says} has no value$"):
        lines.read(("," * header.count(",") + ",0,0,0,0,0,9.8").encode())


@pytest.mark.slow
@pytest.mark.parametrize("course", ["", "0.1,2"])
def test_a_heading_that_nothing_holds_is_said_once(course: str, capsys: pytest.CaptureFixture[str]) -> None:
    """With the magnetometer as source a course does not help."""
    text = "t_s,gx,gy,gz,ax,ay,az,course_rad,speed_mps\n"
    text += "".join(f"{k},0,0,0,0,0,9.81,{course or ','}\n" for k in range(20))
    for heading, n_said in (("mag", 1), ("gps-course", 0 if course else 1)):
        watch = HeadingWatch(["cf"], heading)
        run_pipe({"cf": Stream("cf", heading=heading)}, io.BytesIO(text.encode()), io.StringIO(), see=watch.see)
        watch.end()
        assert capsys.readouterr().err.count("the heading of cf is arbitrary and drifts") == n_said


def test_a_field_holds_the_heading(capsys: pytest.CaptureFixture[str]) -> None:
    watch = HeadingWatch(["cf"], "mag")
    run_pipe({"cf": Stream("cf")}, io.BytesIO(as_text(untidy(), "csv")), io.StringIO(), see=watch.see)
    watch.end()
    assert capsys.readouterr().err == ""


def test_a_short_run_without_a_field_is_said_at_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    watch = HeadingWatch(["cf"], "mag")
    watch.end()
    assert capsys.readouterr().err == ""
    watch.see(Lines().read(b'{"t_ns":0,"gx":0,"gy":0,"gz":0,"ax":0,"ay":0,"az":9.8}'))
    watch.end()
    watch.end()
    assert capsys.readouterr().err.count("no magnetometer (mx, my, mz), so") == 1


@pytest.mark.parametrize(
    "spoil",
    [
        lambda kept: kept["states"].pop("cf"),
        lambda kept: kept.update(states=[]),
        lambda kept: kept.update(states=[1]),
        lambda kept: kept["states"]["cf"]["front"]["guard"].update(t_ns=1e400),
        lambda kept: kept["states"]["cf"].pop("output"),
    ],
)
def test_a_kept_file_that_lacks_something_is_refused(spoil: Callable[[dict], object], tmp_path: Path) -> None:
    run = choose_runs("cf", None, "double", "mag")
    kind, makes = describe_run(run, None, None), {"cf": make_attitude_stream(run[0], None)}
    save_streams(tmp_path / "state.json", open_streams(makes, None, kind), kind)
    assert list(open_streams(makes, tmp_path / "state.json", kind)) == ["cf"]
    kept = json.loads((tmp_path / "state.json").read_text())
    spoil(kept)
    (tmp_path / "spoilt.json").write_text(json.dumps(kept))
    with pytest.raises(BadParameter):
        open_streams(makes, tmp_path / "spoilt.json", kind)


def test_quantiles_are_good_to_two_percent() -> None:
    latency, draw = Latency(), np.random.default_rng(1).lognormal(9, 1, 20_000).astype(int)
    for ns in draw.tolist():
        latency.add(ns)
    assert latency.find_quantile_us(0.5) == pytest.approx(np.median(draw) / 1e3, rel=0.025)
    assert latency.find_quantile_us(0.99) == pytest.approx(np.quantile(draw, 0.99) / 1e3, rel=0.025)
    assert latency.facts()["max_us"] == draw.max() / 1e3
    assert np.isnan(Latency().find_quantile_us(0.5))


def begun(*options: str) -> subprocess.Popen[str]:
    """The command, waiting for samples."""
    return subprocess.Popen(
        [*COMMAND, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_each_estimate_is_there_at_once_and_a_signal_ends_it(number: signal.Signals, tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    with begun("-e", "cf", "--save", str(state), "--json", str(tmp_path / "facts.json")) as process:
        process.stdin.write(f"{HEADER}\n")
        for k in range(3):  # the answer comes before the next sample goes
            process.stdin.write(f"{k * 10_000_000},{AT_REST}\n")
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["t_ns"] == k * 10_000_000
        process.send_signal(number)
        assert process.wait(120) == 0
        said = process.stderr.read()
    assert f"3 samples, 0 malformed lines, {number.name}" in said
    assert re.search(r"estimators: median [\d.]+, p99 [\d.]+, max [\d.]+ us", said)
    assert "Traceback" not in said
    facts = json.loads((tmp_path / "facts.json").read_text())["rows"][0]
    assert facts["n_samples"] == 3
    assert facts["update"]["median_us"] > 0
    assert json.loads(state.read_text())["states"]["cf"]["front"]["guard"]["t_ns"] == 20_000_000


@pytest.mark.slow
def test_a_closed_output_ends_it() -> None:
    with begun("-e", "acc") as process:
        process.stdout.close()
        process.stdin.write("\n".join([HEADER, *(f"{k},{AT_REST}" for k in range(20))]) + "\n")
        process.stdin.close()
        assert process.wait(120) == 0
        said = process.stderr.read()
    assert "closed output" in said
    assert "Traceback" not in said
    assert "Exception ignored" not in said


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no disk that is always full")
def test_a_full_disk_gives_one_line_error_and_the_state_is_kept(tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    with Path("/dev/full").open("w") as full:
        command, text = [*COMMAND, "-e", "cf", "--save", str(state)], f"{HEADER}\n0,{AT_REST}\n"
        done = subprocess.run(command, input=text, text=True, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 2
    assert done.stderr.endswith("stillpoint: standard output: cannot be written (No space left on device)\n")
    assert "Traceback" not in done.stderr
    assert json.loads(state.read_text())["states"]["cf"]["front"]["guard"]["t_ns"] == 0


def waiting_bytes(pipe_out: TextIO) -> int:
    """How much was written into a pipe and not read."""
    return int.from_bytes(fcntl.ioctl(pipe_out, termios.FIONREAD, bytes(4)), sys.byteorder)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_while_nobody_reads_the_output(number: signal.Signals, tmp_path: Path) -> None:
    state, source = tmp_path / "state.json", tmp_path / "samples.csv"
    rows = "".join(f"{k * 10_000_000},{AT_REST}\n" for k in range(2000))  # their estimates are more than a pipe holds
    source.write_text(f"{HEADER}\n{rows}")
    command = [*COMMAND, "-e", "cf", "--save", str(state)]
    with (
        source.open() as given,
        subprocess.Popen(command, stdin=given, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process,
    ):
        begin = process.stdout.read(1)  # it runs
        room = fcntl.fcntl(process.stdout, fcntl.F_GETPIPE_SZ) if hasattr(fcntl, "F_GETPIPE_SZ") else 0
        held, before = waiting_bytes(process.stdout), -1
        while held != before or held < 0.75 * room:  # until the pipe is full; a busy machine stops the process too
            time.sleep(0.5)
            held, before = waiting_bytes(process.stdout), held
        process.send_signal(number)
        assert process.wait(120) == 0
        said, out = process.stderr.read(), begin + process.stdout.read()
    assert f"{number.name}, the output was not read" in said
    assert "Traceback" not in said
    stamps = [json.loads(line)["t_ns"] for line in out.splitlines()]
    assert stamps == list(range(0, len(stamps) * 10_000_000, 10_000_000))
    assert 0 < len(stamps) < 2000
    kept_ns = json.loads(state.read_text())["states"]["cf"]["front"]["guard"]["t_ns"]
    assert kept_ns - stamps[-1] in (0, 10_000_000)


def test_an_empty_input_is_said_without_latencies(feed: Feed) -> None:
    code, out, err = feed("", "-e", "gyro")
    assert (code, out, "nan" in err) == (0, "", False)
    assert err.startswith("stillpoint: 0 samples, 0 malformed lines, end of input\n")


def test_going_on_with_other_options_is_refused(feed: Feed, tmp_path: Path) -> None:
    state = tmp_path / "state.json"
    code, _, err = feed(f"{HEADER}\n0,{AT_REST}\n", "-e", "cf", "--save", state)
    assert code == 0
    assert "1 samples" in err
    code, _, err = feed("", "-e", "cf", "--resume", state, "--set", "cf.zeta=2")
    assert code == 2
    assert "was saved with other options" in err


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["-e", "vqf"], "takes whole recordings only"),
        (["run.mcap"], "--foxglove PORT"),
        (["--foxglove", "8765"], "names no recording"),
        (["--json", "-"], "the standard output is for the estimates"),
        (["--foxglove", "70000", "run.mcap"], "1 to 65535"),
        (["--resume", "nowhere.json"], "cannot be read"),
        (["--declination", "nan"], "declination nan deg: give an angle within"),
        (["--declination", "-inf"], "declination -inf deg: give an angle within"),
        (["--save", "nowhere/state.json"], "Its folder does not exist"),
        (["-e", "vqf,fusion"], "use stillpoint estimate -e vqf,fusion"),
        (["-e", "cf,vqf", "--precision", "single"], "is not for vqf: other packages compute"),
        (["--host", "0.0.0.0"], "--host: is for a replay"),
        (["--speed", "2"], "--speed: is for a replay"),
        (["--foxglove", "0", "--save", "state.json", "run.mcap"], "--save: is for samples from the standard input"),
        (["--foxglove", "0", "--json", "facts.json", "run.mcap"], "--json: is for samples from the standard input"),
        (["--foxglove", "0", "--resume", "state.json", "run.mcap"], "--resume: is for samples from the standard input"),
    ],
)
def test_what_cannot_be_done_gives_one_line_error(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from stillpoint.scripts.main import main

    with pytest.raises(SystemExit) as ended:
        main(["stream", *options])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_a_recording_is_replayed_to_foxglove(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    file = tmp_path / "run.mcap"
    write(file, simulate("phone-1", seed=3, minutes=0.6))
    heard: dict[str, list[bytes]] = {}
    with begun("--foxglove", "0", "-e", "cf,acc", "--speed", "30", str(file)) as process:
        port = int(re.search(r"ws://127\.0\.0\.1:(\d+)$", process.stderr.readline().strip())[1])
        with client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
            topics = subscribed(socket)
            for message in socket:
                if isinstance(message, bytes) and message[0] == 1:  # MessageData: subscription, log time, payload
                    heard.setdefault(topics[int.from_bytes(message[1:5], "little")], []).append(message[5:])
        assert process.wait(120) == 0
    recording = simulate("phone-1", seed=3, minutes=0.6)
    assert set(topics.values()) >= {"/tf", "/estimate/cf/pose", "/estimate/acc/pose", "/imu/data_raw", "/imu/mag"}
    assert len(heard["/imu/data_raw"]) == len(recording.require_imu().t_ns)
    stamps = [int.from_bytes(each[:8], "little") for each in heard["/imu/data_raw"]]
    assert stamps == recording.require_imu().t_ns.tolist()
    assert len(heard["/tf"]) == len(heard["/estimate/cf/pose"]) > 20
    assert b"imu_link/cf" in heard["/tf"][-1]
    assert b"imu_link/acc" in heard["/tf"][-1]


def subscribed(socket) -> dict[int, str]:
    """Subscribe to all that is advertised: topics by number."""
    for message in socket:
        said = json.loads(message) if isinstance(message, str) else {}
        if said.get("op") == "advertise":
            topics = {channel["id"]: channel["topic"] for channel in said["channels"]}
            wanted = [{"id": number, "channelId": number} for number in topics]
            socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            return topics
    raise AssertionError("nothing was advertised")


def test_a_port_that_is_taken_gives_one_line_error(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    import socket

    from stillpoint.scripts.streaming.foxglove import replay_live

    recording = simulate("phone-1", seed=3, minutes=0.6)
    file = tmp_path / "run.mcap"
    write(file, recording)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(BadParameter, match=r"cannot listen on 127\.0\.0\.1"):
            replay_live(file, recording, {}, "127.0.0.1", taken.getsockname()[1], 1.0)
