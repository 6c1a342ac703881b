"""A recording goes in, its reference trajectory comes out; the table of the ways to make one."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother.params import with_settings
from stillpoint.smoother.redistribution import RedistributionParams, redistribution

DEFAULT_METHOD = "redistribution"


@dataclass(frozen=True)
class Method:
    """One way to make a reference."""

    function: Callable[[Recording, Any], Reference]
    defaults: Any  # its settings; their class is what ``params`` must be of
    summary: str


METHODS: dict[str, Method] = {
    "redistribution": Method(
        redistribution,
        RedistributionParams(axes="body"),
        "the gyro between returns to the base pose, closing errors spread in body axes (paper 002)",
    ),
    "redistribution-earth": Method(
        redistribution,
        RedistributionParams(axes="earth"),
        "the same with the closing errors spread in the earth frame, where a gyro's errors pile up",
    ),
}


def method_of(name: str) -> Method:
    """The table's entry; raises :class:`BadParameter` with the nearest name for one that is not there."""
    if name not in METHODS:
        near = get_close_matches(name, METHODS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(METHODS)}"
        raise BadParameter(f"no reference method {name!r}; {hint}")
    return METHODS[name]


def reference(
    recording: Recording, method: str = DEFAULT_METHOD, params: object | Mapping[str, Any] | None = None
) -> Reference:
    """The reference trajectory of a recording.

    ``params`` is an object of the method's settings class, or a mapping of dotted names to values
    (``{"returns.tilt_gate_rad": 0.02}``), or None for the defaults. Raises :class:`BadParameter` for a method or
    setting that is not there, :class:`Unobservable` when the recording does not fix a reference.
    """
    chosen = method_of(method)
    settings = chosen.defaults
    if isinstance(params, Mapping):
        settings = with_settings(settings, params, method)
    elif params is not None:
        if not isinstance(params, type(settings)):
            raise BadParameter(f"{method}: params is a {type(params).__name__}; give a {type(settings).__name__}")
        settings = params
    return replace(chosen.function(recording, settings), params=asdict(settings))
