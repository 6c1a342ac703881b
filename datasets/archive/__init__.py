"""Archives of datasets: keep, find, verify and publish recordings, references, estimates and scores.

with open_archive("lab") as archive:
    list(archive.add([Path("run7.mcap")], tags=["fast"]))
    archive.find("rate > 100 and has:mag and tag:fast")
"""

from stillpoint.datasets.archive.archive import Added, Archive, create_archive, open_archive, resolve_paths
from stillpoint.datasets.archive.catalogue import Entry

__all__ = ["Added", "Archive", "Entry", "create_archive", "open_archive", "resolve_paths"]
