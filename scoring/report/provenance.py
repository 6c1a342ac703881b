"""The provenance that pages state: the recording, the parameters, the versions."""

import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any

from stillpoint.datasets.recording import Recording, rate_hz

_VERSIONS_OF = ("stillpoint", "numpy", "scipy", "numba", "gtsam", "vqf", "bokeh", "matplotlib")


def describe_recording(recording: Recording) -> dict[str, str]:
    """Return what a recording is, by title, for the head of a page; what is not known is left out."""
    info = recording.info
    facts = {
        "duration": f"{recording.duration_s:.1f} s",
        "streams": ", ".join(f"{name} {rate_hz(t_ns):.4g} Hz" for name, t_ns in recording.streams()),
    }
    for title in ("sensor", "source", "date", "licence", "citation"):
        facts[title] = getattr(info, title)
    facts["conversions"] = "; ".join(info.conversions)
    facts["notes"] = "; ".join(info.notes)
    return {title: fact for title, fact in facts.items() if fact}


def flatten_params(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield nested parameters as names such as ``rest.window_s`` with their values as text."""
    for key, value in params.items():
        if isinstance(value, Mapping):
            yield from flatten_params(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", f"{value:.6g}" if isinstance(value, float) else str(value)


def list_versions() -> dict[str, str]:
    """Return the versions of stillpoint, of Python, and of the packages that figures depend on."""
    found = {"python": platform.python_version()}
    for package in _VERSIONS_OF:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
