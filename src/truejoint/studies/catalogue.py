"""Every study by name: the experiments of yan2020 on virtual forceps, and past them, as data."""

from __future__ import annotations

from typing import Final

from truejoint.errors import StudyError, unknown
from truejoint.studies.study import Option, Study

_SPECIMEN: Final = Option(
    "specimen", "A", "nominal, A, B, or a TOML file of your own, which states what is not nominal"
)
_COUNT: Final = Option("count", 0, "so many of a population instead; 0: the specimen")
_MASSES: Final = Option("masses_g", (30.0, 50.0, 100.0, 200.0, 250.0), "weights [g]")
_DIRECTIONS: Final = Option(
    "directions", ("opposing", "along"), "whether weights pull against the motion or along it"
)


_PRIOR: Final = "lugre, capstan, between, or mixed: what frictions are drawn from"
_DRAWN: Final = Option("prior", "mixed", _PRIOR)
_CALIBRATED: Final = Option(
    "motion", "nested", "to calibrate on: nested loops, or calibration, (27)"
)


def _methods(*default: str) -> Option:
    return Option("methods", default, "rows of the table, as in studies/forceps/methods.py")


_UNLOADED: Final = _methods(
    "rigid", "lsm", "lsm_intercept", "lsm_compensated", "poly2", "ukf", "ukf_compensated",
    "play_reset", "play_both", "play_gated", "ukf_friction", "ukf_friction_smoothed",
)  # fmt: skip
_CHOICES: Final = _methods(
    "rigid", "poly2_motor", "play_motor", "poly2_drive", "play_drive",
    "poly2", "ukf_compensated", "play_reset", "play_both", "play_gated", "ukf_friction",
    "lsm", "lsm_compensated", "play_cables",
)  # fmt: skip
_FEW: Final = _methods("ukf_compensated", "play_reset", "play_gated", "ukf_friction")


def _study(name: str, title: str, source: str, *options: Option, version: int = 1) -> Study:
    return Study(
        f"forceps-{name}",
        title,
        source,
        f"truejoint.studies.forceps.{name.replace('-', '_')}",
        options,
        version,
    )


_FORCEPS: Final = (
    _study(
        "unloaded", "How exactly is a jaw known without a load?",
        "yan2020, Table 2, figures 6 and 7", _SPECIMEN, _UNLOADED,
    ),
    _study(
        "loaded", "What do 30 to 250 g on the jaw do to it?",
        "yan2020, Table 3, figure 9", _SPECIMEN, _MASSES, _DIRECTIONS, _FEW,
        Option("draws", 8, "of the hand that hangs each weight", small=2),
    ),
    _study(
        "strategies", "Which sensor buys which accuracy: none on the cables, one, or both?",
        "yan2020, II-B and IV-C",
        _SPECIMEN, _DIRECTIONS, Option("masses_g", (50.0, 100.0, 200.0), "weights [g]"), _CHOICES,
    ),
    _study(
        "population", "Does it hold on other specimens? Every method on each",
        "yan2020, Table 2",
        Option("count", 100, "virtual specimens; more of them begin with the fewer", small=10),
        Option("prior", "lugre", _PRIOR),
        Option("homing_um", 0.0, "standard deviation of the cables' zeros between runs [um]"),
        _UNLOADED,
    ),
    _study(
        "mixed", "Does it hold with other frictions and sizes, unloaded and under weights?",
        "",
        Option("count", 100, "virtual specimens; more of them begin with the fewer", small=4),
        _DRAWN,
        _CALIBRATED,
        _MASSES, _DIRECTIONS,
        _methods("ukf_compensated", "play_reset", "play_both", "play_gated"),
        version=2,
    ),
    _study(
        "load", "How heavy is what hangs on the jaw? Dead band and stiffness",
        "", _SPECIMEN, _COUNT, _DRAWN, _CALIBRATED, _MASSES, _DIRECTIONS, version=2,
    ),
    _study(
        "physical", "Does friction in physical parameters make a better filter?",
        "yan2020, (10) and (11)", _SPECIMEN, _COUNT, _DRAWN, _CALIBRATED, _MASSES, _DIRECTIONS,
    ),
    _study(
        "rezero", "What does a wrong zero after homing cost, and can it be found?",
        "", _SPECIMEN, _COUNT, _DRAWN,
        Option("shifts_um", (0.0, 2.0, 5.0, 10.0, 20.0), "wrong zeros [um]"), _FEW,
    ),
    _study(
        "closed-loop", "How closely does the jaw follow, with an estimate in the loop?",
        "", _SPECIMEN, _methods("ukf_compensated", "play_gated"),
        Option("mass_g", 100.0, "weight on the jaw [g]"),
        Option("swings_hz", (0.2, 0.5, 1.0, 2.0), "rates at which it swings [Hz]"),
        Option("rate_hz", 250.0, "of the loop [Hz]"), Option("gain", 1.5, "of the loop"),
        Option("seconds", 64.8, "of the motion [s], more than 2.2", small=12.0),
        Option("count", 100, "virtual specimens; more of them begin with the fewer", small=4),
        Option("prior", "mixed", "population: lugre, capstan, between or mixed"),
        version=2,
    ),
    _study(
        "sweep", "Which sensors, cables, friction and homing buy which accuracy?",
        "",
        Option("layouts", ("motor", "x1", "x2", "motor+x2", "x1+x2"), "what is measured"),
        Option("resolutions_um", (1.0, 5.0, 20.0), "of the cables' encoders [um]"),
        Option("prices", (4.0, 2.0, 1.0), "of one such encoder at each resolution, in any money"),
        Option("stiffnesses_kNm", (6.0, 9.0, 14.0, 21.0, 32.0), "of both cables [kN/m]"),
        Option("frictions", (1.0,), "of jaw and slider, in that of the specimens"),
        Option("homings_um", (2.0,), "standard deviations of the encoders' zeros [um]"),
        Option("mass_g", 100.0, "weight on the jaw [g]"),
        Option("target_deg", 0.1, "RMS error that a design must keep [deg]"),
        Option("count", 10, "virtual specimens; more of them begin with the fewer", small=2),
        Option("prior", "mixed", "population: lugre, capstan, between or mixed"),
    ),
    _study(
        "recordings", "Recordings of the paper's motions, for truejoint calibrate and evaluate",
        "yan2020, (27), (28) and IV-D",
        Option("specimen", "nominal", _SPECIMEN.meaning),
        Option("motions", ("calibration", "verification", "load"), "(27), (28), a load test"),
        Option("load_g", 100.0, "weight of the load test [g]"),
        Option("direction", "opposing", "how it pulls: opposing, or along"),
        Option("log_rate_hz", 200.0, "rows per second [Hz]"),
    ),
)  # fmt: skip

_WRIST: Final = Study(
    "wrist",
    "How exactly are pitch and jaws of an instrument known, free and under load?",
    "",
    "truejoint.studies.wrist.accuracy",
    (
        Option("count", 24, "virtual instruments; more of them begin with the fewer", small=3),
        Option("family", "mixed", "cable_only, endowrist, measured, or mixed: all by turns"),
        Option("instrument", "420172", "model number or name of a tool, as of robot wrist"),
        Option("free_s", 240.0, "calibration without load [s]", small=60.0),
        Option("loaded_s", 60.0, "calibration under loads [s]", small=20.0),
        Option("test_s", 60.0, "each test [s]", small=15.0),
        Option(
            "methods",
            ("coupling", "linear_motor", "play_motor", "linear_effort", "play_effort"),
            "rows of the table, as in studies/wrist/accuracy.py",
        ),
    ),
)

STUDIES: Final = {study.name: study for study in (*_FORCEPS, _WRIST)}
"""In the order in which they are listed."""


def get_study(name: str) -> Study:
    """Study called `name`; raises StudyError naming those that there are.

    Examples
    --------
    >>> get_study("forceps-unloaded").source
    'yan2020, Table 2, figures 6 and 7'
    """
    if name not in STUDIES:
        raise StudyError(unknown("study", name, STUDIES))
    return STUDIES[name]
