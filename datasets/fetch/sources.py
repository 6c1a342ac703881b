"""Where the published datasets are, under which licence, which files make a trial, and how it is imported.

Every address names one commit of the authors' repository, so that what is fetched cannot change.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import product
from types import MappingProxyType

from stillpoint.datasets.errors import BadParameter, require_known
from stillpoint.datasets.importers.broad import CITATION as BROAD_CITATION
from stillpoint.datasets.importers.tyrex import CITATION as TYREX_CITATION

_GITHUB = "https://raw.githubusercontent.com"
_NO_LICENCE = "none stated by the authors"

_BROAD_TRIALS = (
    "01_undisturbed_slow_rotation_A",
    "02_undisturbed_slow_rotation_B",
    "03_undisturbed_slow_rotation_C",
    "04_undisturbed_slow_rotation_with_breaks_A",
    "05_undisturbed_slow_rotation_with_breaks_B",
    "06_undisturbed_fast_rotation_A",
    "07_undisturbed_fast_rotation_B",
    "08_undisturbed_fast_rotation_with_breaks_A",
    "09_undisturbed_fast_rotation_with_breaks_B",
    "10_undisturbed_slow_translation_A",
    "11_undisturbed_slow_translation_B",
    "12_undisturbed_slow_translation_C",
    "13_undisturbed_slow_translation_with_breaks_A",
    "14_undisturbed_slow_translation_with_breaks_B",
    "15_undisturbed_fast_translation_A",
    "16_undisturbed_fast_translation_B",
    "17_undisturbed_fast_translation_with_breaks_A",
    "18_undisturbed_fast_translation_with_breaks_B",
    "19_undisturbed_slow_combined_240s",
    "20_undisturbed_slow_combined_360s",
    "21_undisturbed_fast_combined",
    "22_undisturbed_fast_combined_240s",
    "23_undisturbed_fast_combined_360s",
    "24_disturbed_tapping_A",
    "25_disturbed_tapping_B",
    "26_disturbed_phone_vibration_A",
    "27_disturbed_phone_vibration_B",
    "28_disturbed_stationary_magnet_A",
    "29_disturbed_stationary_magnet_B",
    "30_disturbed_stationary_magnet_C",
    "31_disturbed_stationary_magnet_D",
    "32_disturbed_attached_magnet_1cm",
    "33_disturbed_attached_magnet_2cm",
    "34_disturbed_attached_magnet_3cm",
    "35_disturbed_attached_magnet_4cm",
    "36_disturbed_attached_magnet_5cm",
    "37_disturbed_office_A",
    "38_disturbed_office_B",
    "39_disturbed_mixed",
)

# Tyrex: three persons, three phones, six motions with and eight without magnets.
_PERSONS, _PHONES = ("Guillaume", "Jakob", "Thibaud"), ("Nexus5", "iPhone4S", "iPhone5")
_WALKED = ("AR", "BackPocket", "FrontPocket", "Phoning", "Swinging", "Texting")
_MOTIONS = tuple(f"Dist_{one}" for one in _WALKED) + tuple(
    f"NoDist_{one}" for one in sorted((*_WALKED, "RunningHand", "RunningPocket"))
)
_TYREX_TRIALS = tuple("_".join(parts) for parts in product(_PERSONS, _PHONES, _MOTIONS))
_OF_BOTH = (
    "accelerometer.txt",
    "gyroscope.txt",
    "magnetometer-calibrated.txt",
    "magnetometer.txt",
    "timeAlignment.txt",
)
_OF_SYSTEM = {"android": ("record.properties", "rotation-vector.txt"), "ios": ("attitude.txt", "description.txt")}

# RepoIMU: the T-stick. Tests 2 to 11 have three trials each, tests 2 and 6 have two. Its pendulum is left out: its
# samples stand twice in the files.
_REPOIMU_TRIALS = (
    "TStick_Test01_Static",
    *(f"TStick_Test{test:02d}_Trial{trial}" for test in range(2, 12) for trial in range(1, 3 if test in (2, 6) else 4)),
)
_REPOIMU_CITATION = (
    "A. Szczesna, P. Skurowski, P. Pruszowski, D. Peszor, M. Paszkuta, K. Wojciechowski: Reference Data Set for "
    "Accuracy Evaluation of Orientation Estimation Algorithms for Inertial Motion Capture Systems. ICCVG, 2016. "
    "doi:10.1007/978-3-319-46418-3_45"
)


@dataclass(frozen=True)
class Source:
    """A published dataset: its address, the files of its trials and the kind of import that reads them."""

    name: str
    title: str
    address: str  # of the folder that the paths of files are relative to
    licence: str
    citation: str
    trials: tuple[str, ...]
    files: Callable[[str], tuple[str, ...]]  # paths of the files of one trial
    item: Callable[[str], str]  # path of the file or folder of one trial that is imported
    kind: str  # of import
    shared: tuple[str, ...] = ()  # files that every trial needs
    settings: Mapping[str, str | bool] = field(default_factory=lambda: MappingProxyType({}))  # flags of the import

    def select(self, wanted: Sequence[str] = ()) -> list[str]:
        """Return the trials that one of the texts means, in the order of the dataset; all of them for no text.

        A text is a name, a beginning of names up to an underscore (``02``, ``Guillaume_Nexus5``) or a glob. Raises
        :class:`BadParameter` for a text that means none.
        """
        for text in wanted:
            if not any(_is_meant(text, trial) for trial in self.trials):
                raise BadParameter(f"{self.name} has no trial {text!r}; --list shows all")
        return [trial for trial in self.trials if not wanted or any(_is_meant(text, trial) for text in wanted)]


def find_source(name: str) -> Source:
    """Return the dataset of a name; raises :class:`BadParameter` with the nearest one for an unknown name."""
    require_known(name, SOURCES, "dataset to fetch")
    return SOURCES[name]


def _is_meant(text: str, trial: str) -> bool:
    """Return whether a text means a trial: by its number or by a pattern."""
    return trial.startswith(f"{text}_") or fnmatchcase(trial, text)


def _find_tyrex_folder(trial: str) -> str:
    return f"datasets/{'ios' if 'iPhone' in trial else 'android'}/{trial}"


def _list_tyrex_files(trial: str) -> tuple[str, ...]:
    folder = _find_tyrex_folder(trial)
    names = (*_OF_BOTH, *_OF_SYSTEM[folder.split("/")[1]])
    return (*(f"{folder}/{name}" for name in sorted(names)), f"datasets/qualisys/{trial}.mat")


_ALL = (
    Source(
        name="broad",
        title="BROAD: 39 trials of an IMU with optical truth",
        address=f"{_GITHUB}/dlaidig/broad/afbaa4d75c4cd7c8ca76b8145b1812312d87fb7f/",
        licence="CC BY 4.0",
        citation=BROAD_CITATION,
        trials=_BROAD_TRIALS,
        files=lambda trial: (f"data_mat/{trial}.mat",),
        item=lambda trial: f"data_mat/{trial}.mat",
        kind="broad",
        shared=("data_mat/trials.json",),
    ),
    Source(
        name="tyrex",
        title="Tyrex: 126 trials of three phones with optical truth",
        address=f"{_GITHUB}/tyrex-team/benchmarks-attitude-smartphones/7b070df5231ac78910ab076eeb026d2d8152a246/",
        licence="CeCILL 2.1",
        citation=TYREX_CITATION,
        trials=_TYREX_TRIALS,
        files=_list_tyrex_files,
        item=_find_tyrex_folder,
        kind="tyrex",
        shared=("LICENCE",),
    ),
    Source(
        name="repoimu",
        title="RepoIMU: 29 trials of an IMU on a stick with optical truth",
        address=f"{_GITHUB}/agnieszkaszczesna/RepoIMU/e8101898804b5191ac707db2080f347cbc8bbc6e/",
        licence=_NO_LICENCE,
        citation=_REPOIMU_CITATION,
        trials=_REPOIMU_TRIALS,
        files=lambda trial: (f"TStick/{trial}.csv",),
        item=lambda trial: f"TStick/{trial}.csv",
        kind="csv",
        # Two lines of titles without names of columns. The field is in units of the Earth's field, 49.6 uT there.
        settings=MappingProxyType(
            {
                "time": "1:s",
                "truth": "2,3,4,5",
                "accel": "6,7,8:m/s^2",
                "gyro": "9,10,11:rad/s",
                "mag": "12,13,14:49.6*uT",
                "licence": _NO_LICENCE,
                "citation": _REPOIMU_CITATION,
            }
        ),
    ),
)
SOURCES: Mapping[str, Source] = MappingProxyType({source.name: source for source in _ALL})
