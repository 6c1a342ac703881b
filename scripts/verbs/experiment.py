"""``stillpoint experiment NAME``: repeat a paper's experiment on simulated trials, beside its printed numbers."""

from cyclopts import App

# name -> (function, what it does); a module is imported when its experiment is called.
EXPERIMENTS: dict[str, tuple[str, str]] = {
    "spin-constant": (
        "spin:constant",
        "Asghari et al. 2018, constant speed: roll angle and rate at 2020 deg/s over 30 s, ten trials.",
    ),
    "spin-variable": (
        "spin:variable",
        "Asghari et al. 2018, variable speed: roll angle and rate at 1500-2100 deg/s over 60 s, ten trials.",
    ),
    "phone-1": (
        "phone:sliding",
        "Elmi Aziz and Mohseni Araste 2021, experiment 1: a phone slid over a table, five trials.",
    ),
    "phone-2": (
        "phone:tripod",
        "Elmi Aziz and Mohseni Araste 2021, experiment 2: a phone on a tripod and its gyro, five trials.",
    ),
    "phone-3": (
        "phone:in_hand",
        "Elmi Aziz and Mohseni Araste 2021, experiment 3: a phone in the hand, CF and Kalman filters, five trials.",
    ),
    "auv-dolphin": (
        "auv:dolphin",
        "Zia 2022: attitude and filter gains of an underwater vehicle, 600 s submerged, five missions.",
    ),
    "servo-bench": (
        "servo:bench",
        "Byambajav et al.: roll and heading of a servo bench by single sensors and by the Kalman filter, five units.",
    ),
}

app = App(name="experiment", help="Repeat a paper's experiment and set the results beside the printed ones.")
for _place, (_name, (_target, _summary)) in enumerate(EXPERIMENTS.items()):
    app.command(f"stillpoint.scripts.verbs.experiments.{_target}", name=_name, help=_summary, sort_key=_place)
