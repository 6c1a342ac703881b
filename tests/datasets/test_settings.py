"""Settings are checked once, changed by dotted names and described; the nearest name is offered."""

from dataclasses import dataclass, field
from math import degrees as in_degrees
from typing import Literal

import numpy as np
import pytest

from stillpoint.datasets import BadParameter
from stillpoint.datasets.errors import nearest, require_known
from stillpoint.datasets.settings import Settings, choice, choose_settings, degrees, describe, list_names, number
from stillpoint.filters import ESTIMATORS
from stillpoint.smoother import METHODS


@dataclass(frozen=True)
class Inner(Settings):
    window_s: float = number(1.0, 0.3, 10.0, "length of the window")
    gate_rad: float = degrees(3.0, 0.1, 30.0, "largest angle")


@dataclass(frozen=True)
class Outer(Settings):
    inner: Inner = field(default_factory=Inner)
    rule: Literal["one", "two"] = choice("one", "which rule")
    is_on: bool = choice(True, "whether it is on")


EVERYTHING = [entry.params() for entry in ESTIMATORS.values()] + [method.defaults for method in METHODS.values()]


@pytest.mark.parametrize(
    ("given", "made"),
    [
        (None, Outer()),
        ({}, Outer()),
        ({"inner.window_s": "2", "rule": "two"}, Outer(Inner(window_s=2.0), "two")),
        ({"inner.window_s": np.int64(2), "is_on": False}, Outer(Inner(window_s=2.0), is_on=False)),
        ({"is_on": "False"}, Outer(is_on=False)),
        ({"is_on": "true"}, Outer()),
        (Outer(rule="two"), Outer(rule="two")),
    ],
)
def test_what_is_given_takes_the_place_of_the_default(given, made):
    found = choose_settings(Outer(), given, "method")
    assert found == made
    assert isinstance(found.inner.window_s, float)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"inner.window_s": 11}, "method: inner.window_s = 11 is not allowed (length of the window); give a number"),
        ({"inner.window_s": "long"}, "from 0.3 to 10"),
        ({"inner.window_s": "nan"}, "from 0.3 to 10"),
        ({"inner.window_s": True}, "from 0.3 to 10"),
        ({"inner.gate_rad": 3.0}, "from 0.001745 to 0.5236"),
        ({"rule": "three"}, "give one, two"),
        ({"is_on": 1}, "give True, False"),
        ({"is_on": "yes"}, "give True, False"),
        ({"inner.windows": 1}, "method: no setting 'inner.windows'; did you mean 'inner.window_s'?"),
        ({"window_s": 1}, "did you mean 'inner.window_s'?"),
        ({"inner": 1}, "no setting 'inner'"),
        ({"rule.one": 1}, "no setting 'rule.one'"),
        ({"inner.window_s.x": 1}, "no setting 'inner.window_s.x'"),
        ({"": 1}, "no setting ''"),
        (Inner(), "give its Outer"),
        ("rule=two", "give its Outer"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(given, says):
    with pytest.raises(BadParameter) as caught:
        choose_settings(Outer(), given, "method")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("field_name", ["window_s", "gate_rad"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, "1", None])
def test_the_constructor_checks_too(field_name, value):
    with pytest.raises(BadParameter, match=field_name):
        Inner(**{field_name: value})


def test_tables_show_angles_in_degrees_and_name_every_setting():
    rows = describe(Outer())
    assert [row.name for row in rows] == list_names(Outer()) == ["inner.window_s", "inner.gate_rad", "rule", "is_on"]
    assert rows[0][1:] == ("1", "0.3 to 10", "length of the window")
    assert rows[1][1:] == ("3 deg", "0.1 to 30", "largest angle")
    assert rows[2][1:] == ("one", "one, two", "which rule")
    assert rows[3][1:] == ("True", "True, False", "whether it is on")
    assert in_degrees(Outer().inner.gate_rad) == pytest.approx(3.0)


@pytest.mark.parametrize("settings", EVERYTHING, ids=lambda settings: type(settings).__qualname__)
def test_every_setting_of_the_program_has_a_meaning_a_range_and_survives_as_text(settings):
    for row in describe(settings):
        assert len(row.meaning) > 10, row.name
        assert row.allowed, row.name
        value = settings
        for part in row.name.split("."):
            value = getattr(value, part)
        assert choose_settings(settings, {row.name: str(value)}, "x") == settings


@pytest.mark.parametrize(
    ("name", "known", "says"),
    [
        ("redistributoin", ["redistribution", "graph"], "did you mean 'redistribution'?"),
        ("magic", ["redistribution", "graph"], "there are redistribution, graph"),
        ("tilt_gate_rad", ["rest.window_s", "returns.tilt_gate_rad"], "did you mean 'returns.tilt_gate_rad'?"),
        ("any", [], "there are none"),
    ],
)
def test_an_unknown_name_suggests_the_nearest(name, known, says):
    assert nearest(name, known) == says
    with pytest.raises(BadParameter) as caught:
        require_known(name, known, "thing")
    assert str(caught.value) == f"no thing {name!r}; {says}"


def test_a_known_name_is_no_error():
    require_known("graph", iter(["redistribution", "graph"]), "method")
