"""The program behind `make soak`, for a few seconds: the stream answers every sample, in order, and does not grow."""

import pytest
from soak import soak


@pytest.mark.slow
def test_three_seconds_at_1_khz_lose_nothing(capsys):
    assert soak(0.05) == 0
    assert "3000 samples" in capsys.readouterr().out
