"""Is the whole recording there? A file that was cut short gives what is whole of it, and a note says what is lost."""

from stillpoint.datasets.doctor.finding import Finding
from stillpoint.datasets.recording import Recording

CUT = ("the file is cut short", "the end of the file is cut off")  # how the notes begin that a reader leaves


def losses(recording: Recording) -> list[str]:
    """What was lost when the recording's file was cut."""
    return [note for note in recording.info.notes if note.startswith(CUT)]


def check_whole(recording: Recording) -> list[Finding]:
    """One finding per loss."""
    return [Finding("file-cut", "warning", f"{note}; copy it again where you can") for note in losses(recording)]
