"""Child processes: what they hear of the signals to their parent."""

import pickle
import signal
from functools import partial
from multiprocessing import resource_tracker

import pytest

from stillpoint.scripts.shared.children import Surroundings, end_children, start_child


@pytest.mark.slow
def test_no_child_hears_an_interrupt_not_even_the_first() -> None:
    # The first process that multiprocessing starts brings its tracker of resources, which clears the mask of signals.
    resource_tracker._resource_tracker._stop()
    child = start_child(pickle.dumps(partial(signal.pthread_sigmask, signal.SIG_BLOCK)), Surroundings())
    child.send(())  # blocks nothing more, and returns what is blocked
    blocked = child.receive().value
    end_children([child])
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
