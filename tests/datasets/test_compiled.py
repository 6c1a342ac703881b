"""How hot loops are compiled: what Python may call and what it may not."""

import numpy as np
import pytest
from from_python import from_python

from stillpoint.datasets.compiled import compiled, compiled_apart, compiled_entry, compiled_inside, like


@compiled_inside
def halved(x: float) -> float:
    return x * like(x, 0.5)


@compiled_apart
def squared(x: float) -> float:
    return x * x


@compiled
def both(x: float) -> float:
    return squared(halved(x))


@compiled_entry
def entered(x: float) -> float:
    return both(x)


@pytest.mark.parametrize("inner", [halved, squared])
def test_without_an_entry_a_call_from_python_is_an_error_and_no_crash_before_and_after_it_is_compiled(inner) -> None:
    for _ in range(2):
        with pytest.raises(TypeError, match=f"{inner.__name__}: only compiled functions"):
            inner(3.0)
        assert entered(3.0) == both(3.0) == 2.25
    assert from_python(inner)(3.0) == inner.py_func(3.0)


def test_constants_are_in_the_precision_of_the_argument() -> None:
    assert type(entered(np.float32(3.0))) is float  # numba hands every float to Python as a double
    assert entered(np.float32(0.1)) == float(np.float32(np.float32(0.05) * np.float32(0.05)))
