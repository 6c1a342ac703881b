"""Parameters of estimators: physical units, with meaning, default and range beside the field, checked once."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from math import isfinite
from numbers import Real
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from stillpoint.datasets.errors import BadParameter


def parameter(default: Any, meaning: str, low: float | None = None, high: float | None = None) -> Any:
    """A field of :class:`Parameters`: what it means and, for a number, the closed range it must lie in."""
    return field(default=default, metadata={"meaning": meaning, "low": low, "high": high})


@dataclass(frozen=True)
class Parameters:
    """Base of every estimator's ``Params``. Raises :class:`BadParameter` for a value out of its range."""

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self))
        for each in fields(self):
            object.__setattr__(self, each.name, _checked(each, hints[each.name], getattr(self, each.name)))


Kind = TypeVar("Kind", bound=Parameters)


def make(kind: type[Kind], values: Kind | Mapping[str, Any] | None) -> Kind:
    """``values`` as an instance of ``kind``; a mapping may leave fields out. Raises :class:`BadParameter`."""
    if isinstance(values, kind):
        return values
    if values is not None and not isinstance(values, Mapping):
        raise BadParameter(f"parameters are {type(values).__module__}.{type(values).__name__}, not of this estimator")
    names = [each.name for each in fields(kind)]
    for name in values or {}:
        if name not in names:
            raise BadParameter(f"no parameter {name!r}; " + nearest(name, names))
    return kind(**(values or {}))


def nearest(name: str, names: list[str]) -> str:
    """ "did you mean ...?", or the names there are."""
    near = get_close_matches(name, names, n=1, cutoff=0.5)
    if near:
        return f"did you mean {near[0]!r}?"
    return f"there are {', '.join(names)}" if names else "it has none"


def describe(kind: type[Parameters]) -> list[tuple[str, str, str, str]]:
    """Name, default, range and meaning of each parameter, for tables."""
    hints = get_type_hints(kind)
    return [
        (each.name, str(each.default), _range(each, hints[each.name]), each.metadata["meaning"])
        for each in fields(kind)
    ]


def _range(each: Any, hint: Any) -> str:
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if hint is bool:
        return "True, False"
    low, high = each.metadata["low"], each.metadata["high"]
    return f"{low:g} to {high:g}"


def _checked(each: Any, hint: Any, value: Any) -> Any:
    if get_origin(hint) is Literal:
        good = value in get_args(hint)
    elif hint is bool:
        good = isinstance(value, bool)
    else:
        good = isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)
        good = good and each.metadata["low"] <= value <= each.metadata["high"]
        value = float(value) if good else value
    if not good:
        raise BadParameter(
            f"{each.name} = {value!r} is not allowed ({each.metadata['meaning']}); give {_range(each, hint)}"
        )
    return value
