"""The table of topics as a page: ``python -m stillpoint.scripts.pages.topics_page > docs/topics.md``."""

from collections.abc import Iterator

from stillpoint.datasets.mcap.topics import BODY_FRAME, LOCAL_FRAME, TOPICS, Topic
from stillpoint.scripts.program import run_program

_TITLES = {
    "recording": "Recordings",
    "reference": "References",
    "roll reference": "Roll references",
    "estimate": "Estimates",
}
_HEAD = f"""# Topics

Which quantity lies where in a file. This page is made from `datasets/mcap/topics.py`:
`python -m stillpoint.scripts.pages.topics_page > docs/topics.md`.

Every topic is `cdr` with the full `ros2msg` definition; log time, publish time and, where there is a header,
`header.stamp` are the same. The frame `{LOCAL_FRAME}` is East-North-Up, `{BODY_FRAME}` is the body of the sensor.
A topic is there only when the recording, reference or estimate has the quantity. What is no column (names,
provenance, parameters, rests, calibration) is JSON in the metadata record `stillpoint`; see [mcap.md](mcap.md).
"""


def main() -> None:
    """Print the page."""
    print(make_page(), end="")


def make_page() -> str:
    """Return the text of ``docs/topics.md``."""
    parts = [_HEAD]
    for kind, title in _TITLES.items():
        topics = [topic for topic in TOPICS if topic.kind == kind]
        rows = [row for topic in topics for row in _list_rows(topic)]
        notes = [f"- `{topic.name}`: {topic.holds}." for topic in topics]
        heading = ["| topic | type | frame | in memory | in the message | unit |", "|---|---|---|---|---|---|"]
        parts.append("\n".join([f"## {title}", "", *heading, *rows, "", *notes, ""]))
    return "\n".join(parts)


def _list_rows(topic: Topic) -> Iterator[str]:
    """Yield one row of the table per column of a topic; only the first names the topic."""
    frame = f"`{topic.frame}`" if topic.frame else ""
    head = f"`{topic.name}` | {topic.type_name.replace('/msg/', '/')} | {frame}"
    for column in topic.columns:
        owner = f"{topic.stream}." if topic.stream and not topic.stream.endswith("remainder") else ""
        path = column.leaves[0].rpartition(".")[0]
        axes = [leaf.removeprefix(f"{path}.") for leaf in column.leaves]
        place = f"`{column.leaves[0]}`" if len(axes) == 1 else f"`{path}` {', '.join(axes)}"
        yield f"| {head} | `{owner}{column.field}` | {place} | {column.unit} |"
        head = " | | "


if __name__ == "__main__":
    run_program(main)
