"""What ``import stillpoint`` offers: the five calls, lazily."""

import subprocess
import sys

import pytest

import stillpoint
from stillpoint import datasets, filters, scoring, smoother


def test_the_calls_are_those_of_their_folders() -> None:
    assert stillpoint.read is datasets.read
    assert stillpoint.write is datasets.write
    assert stillpoint.reference is smoother.reference
    assert stillpoint.estimate is filters.estimate
    assert stillpoint.score is scoring.score
    assert stillpoint.__version__.count(".") >= 1


def test_every_name_that_is_offered_is_there() -> None:
    for name in dir(stillpoint):
        assert getattr(stillpoint, name) is not None


def test_a_wrong_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'refernce'"):
        _ = stillpoint.refernce


def test_importing_the_package_loads_nothing_else() -> None:
    code = "import sys, stillpoint; print(sorted({'numpy', 'numba', 'gtsam', 'scipy'} & set(sys.modules)))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"
