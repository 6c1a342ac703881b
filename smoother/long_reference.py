"""A reference whose columns are made when they are asked for, so that those of a day need not be in memory at once."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from stillpoint.datasets.trajectory import Reference

Columns = Mapping[str, Any]  # arrays by the names of their fields

_COLUMNS = (
    "t_ns",
    "q_nb",
    "cov_b_rad2",
    "gyro_bias_b_radps",
    "position_n_m",
    "velocity_n_mps",
    "position_cov_n_m2",
    "velocity_cov_n_m2ps2",
)


@dataclass(frozen=True, eq=False)
class LongReference:
    """Hold the facts of a :class:`Reference`, and make its columns piece by piece, in the order of time."""

    samples: int
    facts: Mapping[str, Any]  # the fields of a reference that are no columns
    make_columns: Callable[[], Iterator[Columns]]  # columns of neighbouring samples; the same ones in every pass

    def pieces(self) -> Iterator[Reference]:
        """Yield the reference in pieces, each of which carries all facts."""
        for columns in self.make_columns():
            yield Reference(**columns, **self.facts)

    def whole(self) -> Reference:
        """Return the reference in one piece."""
        whole: dict[str, Any] = {}
        done = 0
        for columns in self.make_columns():
            here = len(columns["t_ns"])
            if here == self.samples:
                whole = dict(columns)
                break
            for name, values in columns.items():
                whole.setdefault(name, np.empty((self.samples, *values.shape[1:]), values.dtype))
                whole[name][done : done + here] = values
            done += here
        return Reference(**whole, **self.facts)

    def with_facts(self, **changes: Any) -> "LongReference":
        """Return the reference with other facts."""
        return replace(self, facts={**self.facts, **changes})

    def with_diagnostics(self, found: Mapping[str, Any]) -> "LongReference":
        """Return the reference with more diagnostics."""
        return self.with_facts(diagnostics={**self.facts.get("diagnostics", {}), **found})

    def with_columns(self, change: Callable[[Columns], Columns]) -> "LongReference":
        """Return the reference with columns to which ``change`` is applied, piece by piece."""
        return replace(self, make_columns=lambda: map(change, self.make_columns()))


def as_long_reference(made: Reference) -> LongReference:
    """Return a reference that is in memory as one of a single piece."""
    given = {each.name: getattr(made, each.name) for each in fields(made)}
    columns = {name: given[name] for name in _COLUMNS if given[name] is not None}
    facts = {name: value for name, value in given.items() if name not in _COLUMNS}
    return LongReference(len(made.t_ns), facts, lambda: iter([columns]))
