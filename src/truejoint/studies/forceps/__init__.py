"""The experiments of yan2020 on virtual forceps, and past them, as data."""

from __future__ import annotations

from typing import Final

from truejoint.studies.study import Option, Study

SPECIMEN: Final = Option(
    "specimen", "A", "nominal, A, B, or a TOML file of your own, which states what is not nominal"
)
MASSES: Final = Option("masses_g", (30.0, 50.0, 100.0, 200.0, 250.0), "weights [g]")
DIRECTIONS: Final = Option(
    "directions", ("opposing", "along"), "whether weights pull against the motion or along it"
)
UNLOADED_METHODS: Final = (
    "rigid", "lsm", "lsm_intercept", "lsm_compensated", "poly2", "ukf", "ukf_compensated",
    "play_reset", "play_both", "play_gated", "ukf_friction", "ukf_friction_smoothed",
)  # fmt: skip
STRATEGY_METHODS: Final = (
    "rigid", "poly2_motor", "play_motor",
    "poly2", "ukf_compensated", "play_reset", "play_both", "play_gated",
    "ukf_friction",
    "lsm", "lsm_compensated", "play_cables",
)  # fmt: skip
STEADY_METHODS: Final = ("ukf_compensated", "play_reset", "play_gated", "ukf_friction")


def _methods(default: tuple[str, ...]) -> Option:
    return Option("methods", default, "rows of the table: names in studies/forceps/methods.py")


STUDIES: Final = (
    Study(
        "forceps-unloaded",
        "How exactly is a jaw known without a load?",
        "yan2020, Table 2, figures 6 and 7",
        "truejoint.studies.forceps.unloaded",
        (SPECIMEN, _methods(UNLOADED_METHODS)),
    ),
    Study(
        "forceps-loaded",
        "What do 30 to 250 g on the jaw do to it?",
        "yan2020, Table 3, figure 9",
        "truejoint.studies.forceps.loaded",
        (SPECIMEN, MASSES, DIRECTIONS, _methods(STEADY_METHODS)),
    ),
    Study(
        "forceps-strategies",
        "Which sensor buys which accuracy: none on the cables, one, or both?",
        "yan2020, II-B and IV-C",
        "truejoint.studies.forceps.strategies",
        (
            SPECIMEN,
            Option("masses_g", (50.0, 100.0, 200.0), "weights [g]"),
            DIRECTIONS,
            _methods(STRATEGY_METHODS),
        ),
    ),
    Study(
        "forceps-population",
        "Does it hold on other specimens? Every method on each",
        "yan2020, Table 2",
        "truejoint.studies.forceps.population",
        (
            Option("count", 100, "virtual specimens; more of them begin with the fewer", small=10),
            Option("homing_um", 0.0, "standard deviation of the cables' zeros between runs [um]"),
            _methods(UNLOADED_METHODS),
        ),
    ),
    Study(
        "forceps-load",
        "How heavy is what hangs on the jaw? Dead band and stiffness",
        "",
        "truejoint.studies.forceps.load",
        (SPECIMEN, MASSES, DIRECTIONS),
    ),
    Study(
        "forceps-rezero",
        "What does a wrong zero after homing cost, and can it be found?",
        "",
        "truejoint.studies.forceps.rezero",
        (
            SPECIMEN,
            Option("shifts_um", (0.0, 2.0, 5.0, 10.0, 20.0), "wrong zeros of x2 [um]"),
            _methods(STEADY_METHODS),
        ),
    ),
    Study(
        "forceps-recordings",
        "Recordings of the paper's motions, for truejoint calibrate and evaluate",
        "yan2020, (27), (28) and IV-D",
        "truejoint.studies.forceps.recordings",
        (
            Option("specimen", "nominal", SPECIMEN.meaning),
            Option("motions", ("calibration", "verification", "load"), "(27), (28), a load test"),
            Option("load_g", 100.0, "weight of the load test [g]"),
            Option("direction", "opposing", "or along: how it pulls"),
            Option("log_rate_hz", 200.0, "rows per second [Hz]"),
        ),
    ),
)
