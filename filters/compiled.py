"""How the filters are compiled: as all hot loops are."""

from stillpoint.datasets.compiled import compiled, compiled_apart, compiled_entry, compiled_inside, like

__all__ = ["compiled", "compiled_apart", "compiled_entry", "compiled_inside", "like"]
