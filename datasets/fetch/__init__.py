"""Published datasets with independent truth: where they are, and downloads that are checked.

fetch_trials(find_source("broad"), ["02"], Path("data"))
"""

from stillpoint.datasets.fetch.download import Fetched, fetch_trials
from stillpoint.datasets.fetch.sources import SOURCES, Source, find_source

__all__ = ["SOURCES", "Fetched", "Source", "fetch_trials", "find_source"]
