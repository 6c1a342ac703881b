"""Recordings that several files make references of, and references of them; each is made once per process."""

from dataclasses import replace

import pytest

from stillpoint.datasets.recording import Recording
from stillpoint.datasets.simulate import simulate
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother import reference
from stillpoint.smoother.attitude.params import HANDHELD, GraphParams
from stillpoint.smoother.long_reference import LongReference
from stillpoint.smoother.reference import make_reference_in_pieces


@pytest.fixture(scope="session")
def hand() -> Recording:
    """A rest of a minute, one swing in the hand, and the return."""
    return simulate("phone-3", seed=1, minutes=1.6)


@pytest.fixture(scope="session")
def of_hand(hand: Recording) -> Reference:
    """The reference of ``hand`` with the settings that are the default."""
    return reference(hand)


@pytest.fixture(scope="session")
def swings() -> Recording:
    """Two minutes with several swings in the hand."""
    return simulate("phone-3", minutes=2)


@pytest.fixture(scope="session")
def windowed() -> GraphParams:
    """Settings by which ``swings`` has three windows."""
    return replace(HANDHELD, keys=replace(HANDHELD.keys, window_s=60.0, overlap_s=10.0))


@pytest.fixture(scope="session")
def of_swings(swings: Recording, windowed: GraphParams) -> LongReference:
    """The reference of ``swings`` in three windows, as pieces."""
    long = make_reference_in_pieces(swings, "graph", windowed)
    assert isinstance(long, LongReference)
    return long
