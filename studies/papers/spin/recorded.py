"""The protocol of Asghari et al. 2018 on recordings of one's own motor: identification, then the filters.

D4 and D5 are identified from all recordings with an encoder, by (28) and (30), and the largest of each is used, as in
the paper. Judges are the encoder and the graph of ``roll-graph``, which the encoder does not enter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from stillpoint.datasets.errors import BadRecording, StillpointError
from stillpoint.datasets.recording import Encoder, Recording
from stillpoint.datasets.trajectory import Estimate, SpinReference
from stillpoint.filters import estimate
from stillpoint.scoring.spin import compare_spin, score_spin_comparison
from stillpoint.smoother import reference
from stillpoint.studies.papers.spin.study import (
    FILTERS,
    SMOOTHER,
    Scenario,
    Trial,
    make_series,
    make_settings,
    stream_estimate,
)
from stillpoint.studies.rig.identify import identify_variances

_ENCODER, _GRAPH, _TRUTH = "against the encoder", "against the graph", "against the truth"
RECORDED = (_ENCODER, _GRAPH, _TRUTH)


def identify_noise(recordings: Sequence[Recording]) -> dict[str, float]:
    """Return D4 and D5 as settings of the filters, the largest over the recordings with an encoder; none without one.

    Raises :class:`BadRecording` for a recording of another geometry than the first.
    """
    with_encoder = [one for one in recordings if one.encoder is not None]
    if not with_encoder:
        return {}
    found = identify_variances(with_encoder)
    return {"radial_var_m2ps4": found.d4_m2ps4, "tangential_var_m2ps4": max(found.d5_alone_m2ps4, 1e-8)}


def score_recording(
    recording: Recording, number: int, scenario: Scenario, noise: Mapping[str, float], online: bool, printed: bool
) -> list[Trial]:
    """Return one trial for each judge that the recording has, against which all methods are scored.

    Raises :class:`BadRecording` where it has no accelerometers on a spinning body, or nothing to judge by.
    """
    if recording.spin is None:
        raise BadRecording(
            f"{recording.name}: has no accelerometers on a spinning body; import them with `stillpoint import spin`"
        )
    tuned = replace(scenario, settings={**scenario.settings, **noise})
    made: dict[str, Estimate | SpinReference] = {}
    refused: dict[str, str] = {}
    try:
        graph = reference(recording)
    except StillpointError as error:
        graph, refused[SMOOTHER] = None, str(error)
    for method, name in FILTERS.items():
        settings = make_settings(tuned, method, printed)
        try:
            made[method] = stream_estimate(recording, name, settings) if online else estimate(recording, name, settings)
        except StillpointError as error:
            refused[method] = str(error)
    if isinstance(graph, SpinReference):
        made[SMOOTHER] = graph
    if graph is None and recording.encoder is None and recording.roll_truth is None:
        raise BadRecording(f"no encoder to judge by, and the graph refuses: {refused[SMOOTHER]}")
    judges: dict[str, Any] = {_ENCODER: recording.encoder, _GRAPH: graph, _TRUTH: recording.roll_truth}
    return [
        _score_against(recording, judge, truth, number, made, refused)
        for judge, truth in judges.items()
        if truth is not None
    ]


def _score_against(
    recording: Recording,
    judge: str,
    truth: Encoder | SpinReference,
    number: int,
    made: Mapping[str, Estimate | SpinReference],
    refused: Mapping[str, str],
) -> Trial:
    """Return the scores of all methods against one judge; a method that is the judge is not scored."""
    compared = {method: compare_spin(thing, truth) for method, thing in made.items() if thing is not truth}
    return Trial(
        judge,
        number,
        {method: score_spin_comparison(c) for method, c in compared.items()},
        refused,
        {method: dict(thing.params) for method, thing in made.items()},
        make_series(recording, {method: made[method] for method in compared}, truth),
    )
