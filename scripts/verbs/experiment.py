"""``stillpoint experiment NAME``: a paper's experiment from the simulator to a page beside the paper's own numbers."""

from cyclopts import App

# name -> (function, what it does); a module is imported when its experiment is called.
EXPERIMENTS: dict[str, tuple[str, str]] = {
    "spin-constant": (
        "spin:constant",
        "Paper 000, constant speed: roll angle and rate at 2020 deg/s over 30 s, ten trials.",
    ),
    "spin-variable": (
        "spin:variable",
        "Paper 000, variable speed: roll angle and rate at 1500-2100 deg/s over 60 s, ten trials.",
    ),
    "phone-1": (
        "phone:sliding",
        "Paper 002, experiment 1: a phone slid over a table, five trials.",
    ),
    "phone-2": (
        "phone:tripod",
        "Paper 002, experiment 2: a phone on a tripod and the drift of its gyro, five trials.",
    ),
    "phone-3": (
        "phone:in_hand",
        "Paper 002, experiment 3: a phone in the hand, and CF against Kalman filters, five trials.",
    ),
    "auv-dolphin": (
        "auv:dolphin",
        "Paper 003: attitude and filter gains of an underwater vehicle, 600 s submerged, five missions.",
    ),
    "servo-bench": (
        "servo:bench",
        "Paper 004: roll and heading of a servo bench by single sensors and by the Kalman filter, five units.",
    ),
}

app = App(name="experiment", help="Repeat a paper's experiment and set the results beside the printed ones.")
for _place, (_name, (_target, _summary)) in enumerate(EXPERIMENTS.items()):
    app.command(f"stillpoint.scripts.verbs.experiments.{_target}", name=_name, help=_summary, sort_key=_place)
