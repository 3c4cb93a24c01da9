"""Every study by name, as data: the experiments of peng2024 and yan2020, and past them."""

from __future__ import annotations

from dataclasses import replace
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


_FRICTIONS: Final = Option(
    "prior", "mixed", "lugre, capstan, between, or mixed: what frictions are drawn from"
)
_CALIBRATED: Final = Option(
    "motion", "nested", "to calibrate on: nested loops, or calibration, (27)"
)


def _drawn(count: int, small: int, what: str = "specimens") -> Option:
    meaning = f"virtual {what}; more of them begin with the fewer"
    return Option("count", count, meaning, small=small)


def _methods(*default: str) -> Option:
    return Option("methods", default, "rows of the table, as in studies/forceps/methods.py")


_UNLOADED: Final = _methods(
    "rigid", "lsm", "lsm_intercept", "lsm_compensated", "poly2", "ukf", "ukf_compensated",
    "play_reset", "play_both", "play_gated", "ukf_friction",
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


def _population(name: str, title: str, source: str, *options: Option) -> Study:
    """Study of methods on so many specimens, one module by other options."""
    homing = Option("homing_um", 0.0, "standard deviation of the cables' zeros between runs [um]")
    module = "truejoint.studies.forceps.population"
    return Study(f"forceps-{name}", title, source, module, (*options, _DIRECTIONS, homing), 4)


_WEIGHTS: Final = replace(_MASSES, meaning="weights [g]; 0: none")
_RAVENS: Final = Option(
    "specimens", ("nominal", "peng2024"), "shipped ones, or TOML files of your own",
    small=("peng2024",),
)  # fmt: skip
_NETWORKS: Final = Option("networks", 5, "seeds of the network", small=1)
_NETWORK: Final = replace(_NETWORKS, default=1, small=None)
_SESSIONS: Final = Option("sessions", 1, "homings, each with its own arm's seed and test")
_HOURS: Final = Option("hours", 6, "of unloaded work", small=1)
_MINUTES: Final = Option("minutes", 20.0, "of each random test [min]", small=10.0)


_SETS: Final = Option(
    "sets",
    ("2", "3", "4", "5", "6", "4+5", "5+6", "2+5+6", "3+5+6", "4+5+6"),
    "what is trained on; 4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6 together",
    small=("2", "4", "4+5+6"),
)


_LONGEST: Final = Option("training", "4+5+6", "what is trained on, as in sets of sparsity")


_RAVEN: Final = (
    Study(
        "directions", "Which direction of the zig-zags calibrates best?",
        "peng2024, Table I", "truejoint.studies.raven2.directions",
        (
            _RAVENS,
            Option(
                "directions",
                ("J1", "J2", "J3", "J1-J2", "J2-J3", "J1-J3", "J1-J2-J3"),
                "of the zig-zags; published: J1-J2-J3 in the box of the laboratory's generator",
            ),
            Option("fine", "4+5+6", "what is trained on: zig-zags of sparsity 1/4, 1/5 and 1/6"),
            Option("coarse", "2+3", "what is trained on beside it"),
            _SESSIONS, _NETWORKS, _MINUTES,
        ),
    ),
    Study(
        "sparsity", "How much does more time to calibrate buy?",
        "peng2024, II-F, figure 5", "truejoint.studies.raven2.sparsity",
        (
            _RAVENS, _SETS, Option("repeats", 5, "of everything, with another arm", small=2),
            _NETWORK, _MINUTES,
        ),
    ),
    Study(
        "endurance", "How does a calibration last: six hours idle, at work, under a load?",
        "peng2024, II-G, figures 6 and 7, Table III", "truejoint.studies.raven2.endurance",
        (
            _RAVENS, Option("works", ("idle", "unloaded", "loaded"), "what the arm does"), _SETS,
            Option("hours", 6, "of it", small=2), Option("load_g", 500.0, "on the tool [g]"),
            _SESSIONS, replace(_NETWORKS, default=2),
        ),
        version=2,
    ),
    Study(
        "features", "What do all features of the robot's state cost, against 16 selected ones?",
        "peng2024, II-H, figure 8", "truejoint.studies.raven2.features",
        (
            _RAVENS,
            replace(
                _SETS, default=("2", "4", "5+6", "2+5+6", "3+5+6", "4+5+6"), small=("2", "4+5+6")
            ),
            Option(
                "models", ("dnn", "wide"), "networks; wide: of 600, 500 and 400 units",
                small=("dnn",),
            ),
            _HOURS,
            _SESSIONS, _NETWORK,
        ),
    ),
    Study(
        "homing", "What does a new homing cost, with none or one seen in training?",
        "peng2024, II-I, figure 9", "truejoint.studies.raven2.homing",
        (
            _RAVENS, Option("homings", 5, "after the first"), _LONGEST, Option(
                "sessions", 5, "of every data set, each with another arm", small=2
            ),
            _NETWORK,
            replace(_MINUTES, small=4.0),
        ),
    ),
    Study(
        "targets", "Should a model predict the error, or the joint's position end to end?",
        "peng2024, II-J, Table II", "truejoint.studies.raven2.targets",
        (
            _RAVENS, _SETS, _HOURS,
            _SESSIONS, _NETWORK,
        ),
    ),
    Study(
        "state-of-the-art", "How do joints and tool compare with what others reached?",
        "peng2024, II-K, Tables III and IV", "truejoint.studies.raven2.rivals",
        (
            _RAVENS,
            Option(
                "models",
                (
                    "dnn", "linear", "poly2", "gru", "tcn", "gpr", "forest",
                    "network_forest", "rich_play", "rich_trees",
                ),
                "rows of the tables", small=("dnn", "linear", "gpr", "rich_play"),
            ),
            _LONGEST, replace(_HOURS, small=2), _SESSIONS,
        ),
        version=2,
    ),
    Study(
        "timing", "How long do fitting and inferring take?",
        "peng2024, Table V", "truejoint.studies.raven2.timing",
        (
            Option("models", ("linear", "poly2", "dnn", "rich_play"), "rows of the table"),
            _LONGEST, Option("samples", 20_000, "that go through the loop", small=2000),
            Option("repeats", 3, "of each fit", small=1),
        ),
    ),
)  # fmt: skip

_HOMINGS: Final = replace(
    _SESSIONS, default=10, meaning="homings, each with its own arm's seed", small=2
)
_OF_JOINTS: Final = Option("features", "positioning", "of the positioning joints, or all")
_PAST: Final = (
    Study(
        "efficiency", "Which motion reaches the accuracy of all zig-zags soonest?",
        "", "truejoint.studies.raven2.efficiency",
        (
            _RAVENS, _HOMINGS,
            Option("longest", 5.0, "training by random and designed motion [min]", small=4.0),
            Option("every_s", 15.0, "of training are judged [s]", small=30.0),
            Option("estimator", "linear", "as for truejoint calibrate"),
            _OF_JOINTS,
            Option("test", 10.0, "random motion that it is judged on [min]", small=5.0),
        ),
    ),
    Study(
        "transfer", "What is a calibration worth after a homing, a day, with another tool or arm?",
        "", "truejoint.studies.raven2.transfer",
        (
            _RAVENS, Option("changes", ("homing", "day", "tool", "arm"), "what is new"),
            _HOMINGS,
            Option("first", 5.0, "designed motion of the first calibration [min]", small=4.0),
            Option("estimator", "linear", "linear, poly2, poly2_ridge or rich_play"),
            _OF_JOINTS,
            Option("test", 5.0, "random motion that it is judged on [min]", small=4.0),
        ),
        version=2,
    ),
)  # fmt: skip

_REAL: Final = (
    Study(
        "real", "How do all estimators do on recordings of real joints?",
        "peng2024, Table III (Hwang 2022)", "truejoint.studies.real.accuracy",
        (
            Option(
                "datasets",
                (
                    "davinci_grasper_umn", "dvrk_psm_berkeley", "bros_dual_encoder",
                    "kuka_kr300_dual_encoder", "kflex_tendon_sheath",
                ),
                "public ones on this machine: truejoint datasets",
                small=("dvrk_psm_berkeley", "kuka_kr300_dual_encoder", "kflex_tendon_sheath"),
            ),
            Option(
                "estimators",
                (
                    "linear", "poly2", "dnn", "poly2_ridge", "linear_trees",
                    "rich_play", "rich_trees", "coupled_play", "gp", "gru", "tcn",
                    "ukf_elastic", "hybrid", "auto",
                ),
                "columns of the table, any of -e", small=("linear", "poly2", "dnn", "rich_play"),
            ),
            Option("features", "suited", "of linear, poly2, dnn: suited to the data, or plain"),
            replace(_NETWORKS, default=3),
        ),
        version=2,
    ),
)  # fmt: skip

_FORCEPS: Final = (
    _study(
        "unloaded", "How exactly is a jaw known without a load?",
        "yan2020, Table 2, figures 6 and 7", _SPECIMEN, _UNLOADED, version=2,
    ),
    _study(
        "loaded", "What do 30 to 250 g on the jaw do to it?",
        "yan2020, Table 3, figure 9", _SPECIMEN, _MASSES, _DIRECTIONS, _FEW,
        Option("draws", 8, "of the hand that hangs each weight", small=2),
        version=2,
    ),
    _study(
        "strategies", "Which sensor buys which accuracy: none on the cables, one, or both?",
        "yan2020, II-B and IV-C",
        _SPECIMEN, _DIRECTIONS, Option("masses_g", (50.0, 100.0, 200.0), "weights [g]"), _CHOICES,
        version=2,
    ),
    _population(
        "population", "Does it hold on other specimens? Every method on each", "yan2020, Table 2",
        _drawn(100, 10),
        replace(_FRICTIONS, default="lugre"), replace(_CALIBRATED, default="calibration"),
        replace(_WEIGHTS, default=(0.0,)),
        _UNLOADED,
    ),
    _population(
        "mixed", "Does it hold with other frictions and sizes, unloaded and under weights?", "",
        _drawn(100, 4), _FRICTIONS, _CALIBRATED, _WEIGHTS,
        _methods("ukf_compensated", "play_reset", "play_both", "play_gated"),
    ),
    _study(
        "load", "How heavy is what hangs on the jaw? Dead band and stiffness",
        "", _SPECIMEN, _COUNT, _FRICTIONS, _CALIBRATED, _MASSES, _DIRECTIONS, version=3,
    ),
    _study(
        "rezero", "What does a wrong zero after homing cost, and can it be found?",
        "", _SPECIMEN, _COUNT, _FRICTIONS,
        Option("shifts_um", (0.0, 2.0, 5.0, 10.0, 20.0), "wrong zeros [um]"), _FEW,
        version=2,
    ),
    _study(
        "closed-loop", "How closely does the jaw follow, with an estimate in the loop?",
        "", _SPECIMEN, _methods("ukf_compensated", "play_gated"),
        Option("mass_g", 100.0, "weight on the jaw [g]"),
        Option("swings_hz", (0.2, 0.5, 1.0, 2.0), "rates at which it swings [Hz]"),
        Option("rate_hz", 250.0, "of the loop [Hz]"), Option("gain", 1.5, "of the loop"),
        Option("seconds", 64.8, "of the motion [s], more than 2.2", small=12.0),
        _drawn(40, 4),
        _FRICTIONS,
        version=3,
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
        _drawn(10, 2),
        _FRICTIONS,
        version=2,
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

_FAMILY: Final = Option(
    "family", "mixed", "cable_only, endowrist, measured, or mixed: all by turns"
)
_FREE: Final = Option("free_s", 240.0, "calibration without load [s]", small=60.0)
_UNDER_LOADS: Final = Option("loaded_s", 60.0, "calibration under loads [s]", small=20.0)


def _wrist(name: str, module: str, title: str, count: int, *own: Option) -> Study:
    """Study of so many virtual instruments, calibrated free and under loads."""
    options = _drawn(count, 3, "instruments"), _FAMILY, _FREE, _UNDER_LOADS, *own
    return Study(name, title, "", f"truejoint.studies.wrist.{module}", options, version=3)


_WRIST: Final = (
    _wrist(
        "wrist", "accuracy",
        "How exactly are pitch and jaws of an instrument known, free and under load?", 24,
        Option("instrument", "420172", "model number or name of a tool, as of robot wrist"),
        Option("test_s", 60.0, "each test [s]", small=15.0),
        Option(
            "methods",
            (
                "coupling", "linear_motor", "play_motor", "model", "play_model", "linear_effort",
                "play_effort", "filter", "play_filter",
            ),
            "rows of the table, as in studies/wrist/accuracy.py",
        ),
    ),
    _wrist(
        "wrist-loop", "closed_loop",
        "How exactly do pitch and jaws go where they are wanted, with an estimate in the loop?", 12,
        Option("seconds", 30.0, "of steps that are tracked [s]", small=10.0),
        Option("rate_hz", 200.0, "of the loop [Hz]"),
        Option("gain", 0.7, "share of the remaining error that a step adds"),
        Option(
            "loops",
            (
                "open", "play_motor", "play_effort", "filter", "hybrid", "hybrid_forward",
                "perfect", "perfect_forward",
            ),
            "what stands in them, as in studies/wrist/closed_loop.py; perfect is always one",
        ),
    ),
    _wrist(
        "wrist-changes", "changes",
        "What does an instrument that changed after its calibration cost, and does it show?", 12,
        Option("test_s", 60.0, "under loads after each change [s]", small=15.0),
    ),
)  # fmt: skip

STUDIES: Final = {study.name: study for study in _RAVEN + _PAST + _REAL + _FORCEPS + _WRIST}
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
