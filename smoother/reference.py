"""Make the reference trajectory of a recording; the table of methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from stillpoint.datasets.errors import BadParameter, BadRecording, Unobservable, require_known
from stillpoint.datasets.measurements import drop_non_measurements
from stillpoint.datasets.recording import Recording
from stillpoint.datasets.settings import Settings, choose_settings
from stillpoint.datasets.trajectory import Calibration, Reference, SpinReference
from stillpoint.smoother.attitude.params import PRESETS, GraphParams, allows_vehicle
from stillpoint.smoother.known_calibration import correct_recording, express_in_raw_readings
from stillpoint.smoother.long_reference import LongReference, as_long_reference
from stillpoint.smoother.preset import choose_preset
from stillpoint.smoother.redistribution import RedistributionParams, redistribution, redistribution_earth
from stillpoint.smoother.spin.params import SpinGraphParams

if TYPE_CHECKING:
    from stillpoint.smoother.attitude.long.kept_windows import KeptWindows

DEFAULT_METHOD = "graph"
DEFAULT_SPIN_METHOD = "roll-graph"


@dataclass(frozen=True)
class Method:
    """One way to make a reference."""

    function: Callable[[Recording, Any], LongReference | Reference | SpinReference]
    defaults: Settings  # its settings; their class is what ``params`` must be of
    summary: str


def _graph(
    recording: Recording,
    params: GraphParams,
    generators: Sequence[Any] = (),
    kept: "KeptWindows | None" = None,
) -> LongReference:
    """Make the reference by the factor graph; gtsam, which is not available everywhere, is loaded when needed."""
    try:
        from stillpoint.smoother.attitude.method import make_graph_reference
    except ImportError as error:
        raise BadParameter(
            f"method graph: needs gtsam ({error}), which has packages for Linux x86-64 and macOS; "
            "use --method redistribution here"
        ) from error
    return make_graph_reference(recording, params, generators, kept)


def _spin_graph(recording: Recording, params: SpinGraphParams) -> SpinReference:
    """Run the graph of a spinning body; gtsam is imported only here."""
    try:
        from stillpoint.smoother.spin.graph import make_spin_reference
    except ImportError as error:
        raise BadParameter(
            f"method roll-graph: needs gtsam ({error}), which has packages for Linux x86-64 and macOS; "
            "use `stillpoint estimate -e roll-guarded` here"
        ) from error
    return make_spin_reference(recording, params)


METHODS: dict[str, Method] = {
    "graph": Method(
        _graph,
        PRESETS["handheld"],
        "one calibrating factor graph over the whole recording, with covariances (the default)",
    ),
    "redistribution": Method(
        redistribution,
        RedistributionParams(),
        "the gyro between returns to the base pose, closing errors spread in body axes (rest-pose benchmark)",
    ),
    "redistribution-earth": Method(
        redistribution_earth,
        RedistributionParams(),
        "the same with the closing errors spread in the earth frame, where a gyro's errors accumulate",
    ),
}

SPIN_METHODS: dict[str, Method] = {
    "roll-graph": Method(
        _spin_graph,
        SpinGraphParams(),
        "angle and rate of a spinning body from its accelerometers (the default where there is no gyro of three axes)",
    ),
}
"""Methods for recordings with a spin stream: angle and rate about one axis."""


def _method_of(name: str) -> Method:
    """Return a method of the table; raise :class:`BadParameter` with the nearest name for an unknown one."""
    known = METHODS | SPIN_METHODS
    require_known(name, known, "reference method")
    return known[name]


def _default_method(recording: Recording) -> str:
    """Return the default method for the streams that a recording has."""
    return DEFAULT_SPIN_METHOD if recording.imu is None and recording.spin is not None else DEFAULT_METHOD


def settings_of(method: str, params: Settings | Mapping[str, Any] | None) -> Settings:
    """Return the method's settings with the user's changes; raise :class:`BadParameter` for a wrong one."""
    return choose_settings(_method_of(method).defaults, params, method)


def reference(
    recording: Recording,
    method: str | None = None,
    params: Settings | Mapping[str, Any] | None = None,
    calibration: Calibration | None = None,
    factors: Sequence[Any] = (),
) -> Reference | SpinReference:
    """Return the reference trajectory of a recording: attitude, or angle and rate of a spinning body.

    Samples that are no measurement (zeros, sentinels and frozen values of a sensor that is not working) are dropped and
    counted in the diagnostics, as docs/streaming.md says.

    Parameters
    ----------
    recording
        With an IMU, or with a spin stream.
    method
        One of METHODS or SPIN_METHODS; by default the graph that fits the recording's streams.
    params
        An object of the method's settings class, or a mapping of dotted names to values
        (``{"returns.tilt_gate_rad": 0.02}``), or None for the defaults. The defaults of the graph are those of the
        preset that the recording speaks for (:func:`~stillpoint.smoother.preset.choose_preset`), which the
        diagnostics name.
    calibration
        What is known of the sensor, as of an earlier reference: readings are corrected by it first.
    factors
        Generators of factors to add to the graph, see :mod:`stillpoint.smoother.attitude.outside.added`.

    Raises
    ------
    BadParameter
        A method or setting that is not there; a factor that cannot be added.
    Unobservable
        The recording does not determine a reference.
    """
    made = make_reference_in_pieces(recording, method, params, calibration, factors)
    return made.whole() if isinstance(made, LongReference) else made


def make_reference_in_pieces(
    recording: Recording,
    method: str | None = None,
    params: Settings | Mapping[str, Any] | None = None,
    calibration: Calibration | None = None,
    factors: Sequence[Any] = (),
    kept: "KeptWindows | None" = None,
) -> LongReference | SpinReference:
    """Return :func:`reference`, of which an attitude comes in pieces, for files; arguments and errors are the same.

    Windows that are ``kept``, of a run on the same recording by the same code, are not solved again, and others are
    added to them as they are solved. Where there are ``factors`` of users, none is kept.
    """
    name = _default_method(recording) if method is None else method
    function = _method_of(name).function
    if factors:
        if name != "graph":
            raise BadParameter(f"factors: are for the method graph, not {name}")
        function = partial(_graph, generators=factors)
    elif name == "graph":
        function = partial(_graph, kept=kept)
    settings = settings_of(name, params)  # first: a wrong setting needs no recording to be refused
    recording, dropped = drop_non_measurements(recording)
    chosen: dict[str, str] = {}
    if name == "graph" and not isinstance(params, Settings):
        preset = choose_preset(recording)
        chosen = {"preset": preset.name, "preset_reason": preset.reason}
        settings = choose_settings(PRESETS[preset.name], params, name)
    try:
        if calibration is None:
            made = _to_pieces(function(recording, settings))
        else:
            made = _to_pieces(function(correct_recording(recording, calibration), settings))
            if isinstance(made, LongReference):
                made = express_in_raw_readings(made, calibration)
    except Unobservable as error:
        raise _blame_preset(recording, settings, error) from error
    found = {**chosen, **dropped.counts()}
    if isinstance(made, LongReference):
        return made.with_facts(params=asdict(settings)).with_diagnostics(found)
    return replace(made, params=asdict(settings), diagnostics={**made.diagnostics, **found})


def _to_pieces(made: LongReference | Reference | SpinReference) -> LongReference | SpinReference:
    return as_long_reference(made) if isinstance(made, Reference) else made


def _blame_preset(recording: Recording, settings: Settings, error: Unobservable) -> Unobservable:
    """Return the error that names the preset as the reason where the recording looks like a vehicle's."""
    if not isinstance(settings, GraphParams) or allows_vehicle(settings):
        return error
    preset = choose_preset(recording)
    if preset.name != "vehicle":
        return error
    found = str(error).removeprefix(f"{recording.name}: ")
    return Unobservable(
        f"{recording.name}: this looks like a vehicle ({preset.reason}): --preset vehicle; as it is, {found}"
    )


def attitude_reference(
    recording: Recording, method: str = DEFAULT_METHOD, params: Settings | Mapping[str, Any] | None = None
) -> Reference:
    """Return :func:`reference` for callers that need an attitude; raises :class:`BadRecording` for an angle."""
    made = reference(recording, method, params)
    if not isinstance(made, Reference):
        raise BadRecording(f"{recording.name}: {method} gives an angle about one axis; an attitude is needed here")
    return made
