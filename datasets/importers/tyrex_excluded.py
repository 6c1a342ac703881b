"""Stretches of the Tyrex trials that their authors left out of the comparison, marked by hand.

Seconds of the Qualisys clock, from ``AttitudeBenchmarks.m`` of the authors' benchmark. In most the markers were
swapped or hidden; in Guillaume_Nexus5_NoDist_AR the truth is right and the phone's gyro stopped twice.
"""

EXCLUDED_S: dict[str, tuple[tuple[float, float], ...]] = {
    "Guillaume_iPhone4S_NoDist_BackPocket": ((21.1, 21.5), (23.6, 24.0)),
    "Guillaume_iPhone5_Dist_FrontPocket": ((65.6, 67.2), (100.4, 102.0)),
    "Guillaume_iPhone5_Dist_Swinging": ((103.5, 104.5),),
    "Guillaume_iPhone5_NoDist_BackPocket": (
        (5.7, 6.1),
        (7.9, 8.5),
        (9.1, 9.6),
        (24.7, 25.3),
        (26.0, 26.5),
        (76.4, 77.3),
    ),
    "Guillaume_Nexus5_Dist_FrontPocket": ((21.2, 21.6),),
    "Guillaume_Nexus5_Dist_Phoning": ((40.5, 40.8),),
    "Guillaume_Nexus5_Dist_Swinging": ((59.7, 60.5), (73.1, 73.5)),
    "Guillaume_Nexus5_NoDist_AR": ((64.0, 120.0),),
    "Jakob_iPhone4S_NoDist_RunningHand": ((34.8, 49.2),),
    "Jakob_iPhone5_NoDist_RunningHand": ((16.0, 17.0), (30.0, 37.5), (39.8, 40.2)),
    "Jakob_Nexus5_Dist_Phoning": ((4.7, 5.6), (91.95, 93.2)),
    "Jakob_Nexus5_Dist_Swinging": ((96.2, 97.5),),
    "Jakob_Nexus5_NoDist_RunningHand": ((36.0, 47.5),),
    "Thibaud_iPhone4S_NoDist_Texting": ((51.4, 51.8),),
    "Thibaud_iPhone5_Dist_AR": ((0.0, 2.5), (65.8, 66.5), (87.1, 87.6)),
    "Thibaud_iPhone5_Dist_FrontPocket": ((52.3, 52.8), (61.2, 61.7)),
    "Thibaud_Nexus5_Dist_FrontPocket": ((40.0, 52.6),),
    "Thibaud_Nexus5_Dist_Phoning": ((10.8, 14.0), (18.0, 19.6), (44.8, 46.4), (87.0, 88.0), (90.4, 91.0)),
    "Thibaud_Nexus5_Dist_Swinging": ((105.45, 105.5),),
    "Thibaud_Nexus5_NoDist_Swinging": ((36.8, 37.2),),
}
