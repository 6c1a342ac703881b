"""The table of topics: quaternions as ROS has them, tesla that come back to the bit, a page that is up to date."""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from stillpoint.datasets import Imu, Mag, Recording, Truth, write
from stillpoint.datasets.mcap.topics import TOPICS, to_microtesla, to_tesla
from stillpoint.scripts.pages import topics_page

DOCS = Path(__file__).parents[3] / "docs"


def test_the_page_is_made_from_the_table_as_it_is():
    assert (DOCS / "topics.md").read_text(encoding="utf-8") == topics_page.make_page()


def test_every_topic_is_there_once():
    names = [topic.name for topic in TOPICS]
    assert len(names) == len(set(names))


@settings(max_examples=500)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_double_in_microtesla_comes_back_from_tesla_to_the_bit(value):
    given_ut = np.array([[value]])
    assert to_microtesla(*to_tesla(given_ut)).tobytes() == given_ut.tobytes()


def test_few_values_need_a_remainder_and_it_is_an_exact_last_digit():
    """Doubles in [1.907, 2) x 2^k microtesla outnumber those in tesla by two: half of them, 1 in 29 of all sizes."""
    rng = np.random.default_rng(4)
    field_ut = np.exp(rng.uniform(np.log(1), np.log(1024), (200_000, 1))) * rng.choice([-1.0, 1.0], (200_000, 1))
    field_t, remainder = to_tesla(field_ut)
    assert to_microtesla(field_t, remainder).tobytes() == field_ut.tobytes()
    share = np.mean(remainder != 0)
    assert abs(share - np.log2(2 / 1.9073) * 0.5) < 0.002
    assert (np.abs(remainder) <= 2 * np.spacing(np.abs(field_ut))).all()


def test_ros_readers_find_xyzw_and_tesla(tmp_path):
    """An attitude without symmetry, 40 uT to the east: in the order and the unit of the message's definition."""
    q_wxyz = np.array([[0.8, 0.4, -0.2, 0.4]])
    recording = Recording(
        "one",
        imu=Imu(np.array([5]), [[1.0, 2.0, 3.0]], [[0.0, 0.0, 9.8]]),
        mag=Mag(np.array([6]), [[40.0, 0.0, 0.0]]),
        truth=Truth(np.array([7_000_000_008]), q_wxyz, np.array([True]), [[1.0, 2.0, 3.0]]),
    )
    write(tmp_path / "one.mcap", recording)
    with (tmp_path / "one.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
    q = found["/truth/pose"].pose.orientation
    assert (q.x, q.y, q.z, q.w) == (0.4, -0.2, 0.4, 0.8)
    assert found["/imu/mag"].magnetic_field.x == 40e-6
    assert (found["/truth/pose"].header.stamp.sec, found["/truth/pose"].header.stamp.nanosec) == (7, 8)
    assert found["/truth/pose"].header.frame_id == "map"
    assert found["/imu/data_raw"].orientation_covariance[0] == -1  # no orientation in this message
    assert found["/truth/moving"].data
