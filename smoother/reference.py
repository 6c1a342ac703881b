"""A recording goes in, its reference trajectory comes out; the table of the ways to make one."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from stillpoint.datasets.errors import BadParameter
from stillpoint.datasets.nearest import require_known
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.settings import Settings, chosen
from stillpoint.datasets.trajectory import Reference
from stillpoint.smoother.graph_params import PRESETS, GraphParams
from stillpoint.smoother.redistribution import RedistributionParams, redistribution, redistribution_earth

DEFAULT_METHOD = "graph"


@dataclass(frozen=True)
class Method:
    """One way to make a reference."""

    function: Callable[[Recording, Any], Reference]
    defaults: Settings  # its settings; their class is what ``params`` must be of
    summary: str


def _graph(recording: Recording, params: GraphParams) -> Reference:
    """The factor graph; gtsam is loaded when it is needed, as it is not to be had everywhere."""
    try:
        from stillpoint.smoother.calibrating import calibrating_graph
    except ImportError as error:
        raise BadParameter(
            f"method graph: needs gtsam ({error}), which has packages for Linux x86-64 and macOS; "
            "use --method redistribution here"
        ) from error
    return calibrating_graph(recording, params)


METHODS: dict[str, Method] = {
    "graph": Method(
        _graph,
        PRESETS["handheld"],
        "one calibrating factor graph over the whole recording, with covariances (the default)",
    ),
    "redistribution": Method(
        redistribution,
        RedistributionParams(),
        "the gyro between returns to the base pose, closing errors spread in body axes (paper 002)",
    ),
    "redistribution-earth": Method(
        redistribution_earth,
        RedistributionParams(),
        "the same with the closing errors spread in the earth frame, where a gyro's errors pile up",
    ),
}


def method_of(name: str) -> Method:
    """The table's entry; raises :class:`BadParameter` with the nearest name for one that is not there."""
    require_known(name, METHODS, "reference method")
    return METHODS[name]


def settings_of(method: str, params: Settings | Mapping[str, Any] | None) -> Settings:
    """The method's settings with what the user gave; raises :class:`BadParameter`."""
    return chosen(method_of(method).defaults, params, method)


def reference(
    recording: Recording, method: str = DEFAULT_METHOD, params: Settings | Mapping[str, Any] | None = None
) -> Reference:
    """The reference trajectory of a recording.

    ``params`` is an object of the method's settings class, or a mapping of dotted names to values
    (``{"returns.tilt_gate_rad": 0.02}``), or None for the defaults. Raises :class:`BadParameter` for a method or
    setting that is not there, :class:`Unobservable` when the recording does not fix a reference.
    """
    settings = settings_of(method, params)
    return replace(method_of(method).function(recording, settings), params=asdict(settings))
