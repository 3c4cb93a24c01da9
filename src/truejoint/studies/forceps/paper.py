"""Tables 2 and 3, figures 6, 7 and 9 of yan2020: the jaw without a load, and under weights."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from pandas import DataFrame, Series

from truejoint.array_types import Array, Mask
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies import claim_tests as claims
from truejoint.studies.forceps import methods as m
from truejoint.studies.rows import frame_table, notes_on, reported, reported_text, select, unique
from truejoint.studies.study import Part, PartResult, Plain, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed

_RUNS: Final = {"calibration": "(27)", "verification": "(28)"}
_PRINTED: Final = {"largest": "max", "smallest": "min", "rms": "rms"}
"""Sizes of errors that the paper prints, by our columns."""
_MORE: Final = ("amplitude", "farthest", "reversing", "between")
REVERSAL: Final = 0.5
"""Time from a reversal within which an error counts as made there [s]."""
_OURS: Final = (m.PAPERS_BEST, "ukf_friction", m.BEST)


def unloaded_parts(settings: Settings) -> Sequence[Part]:
    """One a draw of the sensors' noise: a specimen on both motions."""
    common = m.common_arguments(settings)
    seeds = range(settings.seed, settings.seed + settings["draws"])
    return [
        Part(f"unloaded-{draw}", compare, {**common, "seed": seed}, {"draw": draw})
        for draw, seed in enumerate(seeds)
    ]


def compare(forceps: Plain, methods: Sequence[str], seed: int) -> PartResult:
    """Calibrate methods on (27), and judge them there and on (28), with noise of its own."""
    plant, rows = ForcepsParameters.from_dict(forceps), Rows()
    arrays: dict[str, Array] = {}
    models = m.calibrated(plant, tuple(methods), seed)
    for number, motion in enumerate(_RUNS):
        judged = m.judge(models, m.settled(m.record(plant, motion, seed=2 * seed + number)))
        turning = near_reversal(motion, judged["t"])
        for row in m.errors(judged, motion=motion):
            error = judged[row["method"]] - judged["truth"]
            where = {"reversing": m.rms(error[turning]), "between": m.rms(error[~turning])}
            rows.append({**row, **where})
        arrays |= {f"{motion}/{name}": values for name, values in judged.items()}
    return PartResult(rows, arrays)


def near_reversal(motion: str, t: Array) -> Mask:
    """Rows (n,) at times `t` (n,) [s] that are near where a motion reverses."""
    steps = np.diff(m.trajectory(motion).positions[:, 0])
    turns = SETPOINT_DT * np.flatnonzero(steps[1:] * steps[:-1] < 0.0)
    return np.asarray(np.abs(t[:, None] - turns).min(axis=1) <= REVERSAL)


def unloaded_summary(results: Results) -> Summary:
    """Table 2, figures 6 and 7, beside the paper's."""
    settings, name = results.settings, Path(results.settings["specimen"]).stem
    rows = select(results.rows, draw=0).set_index("method", drop=False)
    verified = select(rows, motion="verification")

    def paper(table: str, motion: int, metric: str) -> list[str]:
        there = (reported("yan2020", table, f"trajectory {motion}", key) for key in verified.index)
        return [reported_text(printed.get(metric)) for printed in there]

    def degrees(rows: DataFrame, column: str, decimals: int = 3) -> list[str]:
        return [fixed(value, decimals) for value in np.degrees(rows[column])]

    cells = {
        "sensors": [", ".join(m.METHODS[key].sensors) for key in verified.index],
        "RMS": degrees(verified, "rms"),
        "paper": paper("2", 28, "rms"),
        "max": degrees(verified, "largest", 2),
        "paper ": paper("2", 28, "max"),
        "min": degrees(verified, "smallest", 2),
        "paper  ": paper("2", 28, "min"),
        "RMS on (27)": degrees(select(rows, motion="calibration").loc[verified.index], "rms"),
        " paper": paper("figure 6", 27, "rms"),
        "RMS to the jaw": degrees(verified, "exact_rms"),
    }
    notes = notes_on("unloaded", **settings.options, rule=claims.RULE)
    notes += m.note_left_out(settings, verified)
    title = f"yan2020 Table 2 and figure 6, specimen {name}"
    body = DataFrame(cells, [m.TITLES[key] for key in verified.index])
    table = frame_table(title, body, notes, head="method")
    figure = _unloaded_figure(results.arrays["unloaded-0"], name)
    if m.PAPERS_BEST not in rows.index:
        return Summary((table,), {"forceps-unloaded": figure})
    without = () if set(m.PAPERS) <= set(rows.index) else _OF_LEAST_SQUARES
    judged = claims.judged(UNLOADED_CLAIMS, sized(results.rows), without=without)
    return Summary((table,), {"forceps-unloaded": figure}, judged)


def sized(rows: DataFrame) -> DataFrame:
    """Rows of one size of an error each [deg], as claims compare them; a draw is a session."""
    least, most = -rows.smallest, rows.largest
    far = np.maximum(most, least)
    rows = rows.assign(amplitude=most + least, farthest=far, smallest=least)
    long = rows.melt(["method", "motion", "draw"], [*_PRINTED, *_MORE], "size", "rmse")
    return long.assign(session=long.draw, rmse=np.degrees(long.rmse))


def _sizes(
    rows: DataFrame, method: str, table: str = "2", run: str = "verification"
) -> claims.Verdict:
    """Judge whether a method's largest, least and RMS errors are those that a table prints."""
    there = reported("yan2020", table, f"trajectory {_RUNS[run][1:-1]}", method)
    pick = partial(claims.by_session, rows, method=method, motion=run)
    return claims.matches(
        [(f"|{key}|", pick(size=size), abs(there[key])) for size, key in _PRINTED.items()]
    )


def _saving(rows: DataFrame, size: str, printed: float) -> claims.Verdict:
    """Judge whether the filter's error is below that of compensated least squares by so much."""
    pick = {"method": m.PAPERS_BEST}, {"method": m.PAPERS[1]}
    saved = 1.0 - claims.errors(rows, pick, size=size, motion="verification")
    text = f"{100 * saved.mean():.0f} % below; 10 % more or less counts as about"
    return claims.about(saved, printed - 0.1, printed + 0.1), text


def _next(rows: DataFrame, method: str, **where: Any) -> Array:
    """Errors of the method that the paper finds next better."""
    return claims.by_session(rows, method=m.PAPERS[m.PAPERS.index(method) + 1], **where)


_OTHERS: Final = {"method": m.PAPERS[:2], "motion": ("verification",), "size": ("rms",)}
UNLOADED_CLAIMS: Final = claims.statements(
    "forceps-unloaded",
    {
        "27-sizes": partial(_sizes, method=m.PAPERS_BEST, table="figure 6", run="calibration"),
        "28-sizes": partial(_sizes, method=m.PAPERS_BEST),
        "lsm-sizes": partial(_sizes, method=m.PAPERS[0]),
        "compensated-sizes": partial(_sizes, method=m.PAPERS[1]),
        "order": claims.ordered(_next, {}, _OTHERS),
        "49-percent": partial(_saving, size="amplitude", printed=0.49),
        "54-percent": partial(_saving, size="rms", printed=0.54),
    },
)
_OF_LEAST_SQUARES: Final = (
    "lsm-sizes", "compensated-sizes", "order", "49-percent", "54-percent", "one-sensor",
)  # fmt: skip


def _unloaded_figure(arrays: Mapping[str, Array], name: str) -> Figure:
    panels: list[list[Panel]] = [[], [], []]
    for run, motion in _RUNS.items():
        signals = {k.removeprefix(f"{run}/"): v for k, v in arrays.items() if run in k}
        t, truth = signals.pop("t"), signals.pop("truth")
        curves = [Curve(t, np.degrees(truth), "encoder", "k")]
        if m.PAPERS_BEST in signals:
            estimate = np.degrees(signals[m.PAPERS_BEST])
            curves.append(Curve(t, estimate, m.TITLES[m.PAPERS_BEST], style="--"))
        panels[0].append(Panel(curves, y=f"jaw on {motion} [deg]", legend=True))
        for line, keys in zip(panels[1:], (m.PAPERS, _OURS), strict=True):
            errors = [
                Curve(t, np.degrees(signals[key] - truth), m.TITLES[key], m.METHODS[key].colour)
                for key in keys
                if key in signals
            ]
            line.append(Panel(errors, "time [s]", "error [deg]", legend=bool(errors)))
    caption = "Angles and errors on both motions: the paper's methods in the middle, ours below."
    return Figure(f"yan2020 figures 6 and 7, specimen {name}", panels, caption, height=8.0)


MAX_DRAWS: Final = 1000
JUDGED: Final = ("I", "II", "IV")
_HAND: Final = "III"  # the weight is being hung on
SHIFT: Final = 8.0
"""Between the weights' curves in figure 9(a) [deg]."""
_LIGHT: Final = 0.05  # [kg]
_AVERAGE: Final = 0.25  # [s]


def loaded_parts(settings: Settings) -> Sequence[Part]:
    """One a weight, direction and draw of the hand."""
    common, draws = m.common_arguments(settings), settings["draws"]
    if not 1 <= draws <= MAX_DRAWS:
        raise StudyError(f"draws={draws}; it must be 1 to {MAX_DRAWS}")
    return [
        Part(
            f"{key}-{draw}" if draw else key, hang,
            {**common, **case, "hand": case["hand"] + 100 * draw},
            {"mass": case["mass"], "direction": case["direction"], "draw": draw},
        )
        for draw in range(draws)
        for key, case in cases(settings).items()
    ]  # fmt: skip


def cases(settings: Settings) -> dict[str, dict[str, Any]]:
    """Weight [kg], direction and seed of the hand's wobble of each load test, by a part's key."""
    tests = [m.load_test(g / 1e3, d) for d in settings["directions"] for g in settings["masses_g"]]
    return {
        f"{1e3 * test.mass:g}g-{test.direction}": {
            "mass": test.mass, "direction": test.direction, "hand": 100 * settings.seed + number
        }
        for number, test in enumerate(tests, 1)
    }  # fmt: skip


def hang(
    forceps: Plain, methods: Sequence[str], seed: int, mass: float, direction: str, hand: int
) -> PartResult:
    """Calibrate methods unloaded on (27), and judge them while one weight is hung on the jaw."""
    plant, test = ForcepsParameters.from_dict(forceps), m.load_test(mass, direction)
    models = m.calibrated(plant, tuple(methods), seed)
    judged = m.judge(models, m.record(plant, test, seed=hand))
    t, exact = judged["t"], judged["exact"]
    still = [exact[m.within(t, *test.phases[phase])].mean() for phase in ("II", "IV")]
    turn, rows = float(still[1] - still[0]), Rows()
    for phase in (*JUDGED, _HAND):
        rows += m.errors(judged, *test.phases[phase], phase=phase, turn=turn)
    return PartResult(rows, {**judged, "released": np.array(test.phases["III"])})


def loaded_summary(results: Results) -> Summary:
    """Table 3 beside the paper's, and figure 9."""
    settings, rows = results.settings, results.rows
    specimen, methods = Path(settings["specimen"]).stem, unique(rows, "method")
    rows = rows.assign(
        load=(1e3 * rows.mass).map("{:.0f} g ".format) + rows.direction,
        name=rows.method.map(m.TITLES),
        session=rows.draw,
        rmse=np.degrees(rows.rms),
    )
    loads = rows.groupby("load", sort=False)

    def paper(phases: Sequence[str], *metrics: str) -> list[str]:
        """Numbers of Table 3 by weight, those of one weight joined by slashes."""
        rows = [
            [(f"load={1e3 * mass:.0f}g phase {phase}", metric) for phase, metric in wanted]
            for mass in loads.mass.first()
            for wanted in [list(product(phases, metrics))]
        ]
        return ["/".join(_printed(*cell) for cell in row) for row in rows]

    def table(title: str, texts: Series, notes: Sequence[str] = (), **first: Any) -> Table:
        """Texts by load and method, behind the columns `first`."""
        frame = DataFrame(first, loads.mass.first().index)
        cells = texts.unstack("name").loc[frame.index, unique(rows, "name")]
        return frame_table(f"{name}: {title}", frame.join(cells), notes, head="load")

    by = rows.groupby(["load", "name", "phase"], sort=False)
    rms = np.rad2deg(1.0) * by.rms.quantile(np.array([0.5, 0.0, 1.0])).unstack()
    rms = rms.map(partial(fixed, decimals=3))
    medians = rms[0.5].unstack("phase")[list(JUDGED)].agg("/".join, axis=1)
    spread = rms[0.5] + " (" + rms[0.0] + " to " + rms[1.0] + ")"
    ends = np.rad2deg(1.0) * by.agg({"largest": "max", "smallest": "min"})
    ends = ends.map(partial(fixed, decimals=2)).agg("/".join, axis=1)
    turns = np.rad2deg(1.0) * rows.drop_duplicates("part").groupby("load").turn.median()
    notes = notes_on("loaded", draws=rows.draw.nunique())
    notes += [*m.note_left_out(settings, rows), claims.RULE]
    name = f"yan2020 Table 3, specimen {specimen}"
    tables = (
        table(
            "RMS, median of the draws", medians, notes,
            **{"jaw turns": turns.map(partial(fixed, decimals=2)), "paper": paper(JUDGED, "rms")},
        ),
        table(
            "RMS in phase IV, median (least to largest)", spread.xs("IV", level="phase"),
            paper=paper(["IV"], "rms"),
        ),
        table(
            "largest/smallest error in phase I", ends.xs("I", level="phase"),
            paper=paper(["I"], "max", "min"),
        ),
    )  # fmt: skip
    figures = _loaded_figures(results, methods, specimen)
    if m.PAPERS_BEST not in methods:
        return Summary(tables, figures)
    without = () if (rows.mass < _LIGHT).any() else ("light",)
    return Summary(tables, figures, claims.judged(LOADED_CLAIMS, rows, without=without))


def _printed(condition: str, metric: str) -> str:
    return reported_text(reported("yan2020", "3", condition, m.PAPERS_BEST).get(metric))


def _within(
    rows: DataFrame, phase: str, limit: float, lightest: float = math.inf
) -> claims.Verdict:
    """Judge whether the filter's error in a phase, or the jaw's turn, stays below a limit [deg].

    The largest of the weights below one [kg], in each direction: the paper does not say which way
    it loaded, so where one direction differs, it cannot be told.
    """
    rows = rows[rows.mass < lightest]
    angle = select(rows, phase=phase or "IV", method=m.PAPERS_BEST)
    angle = angle.assign(angle=np.degrees(angle.rms if phase else angle.turn.abs()))
    within, texts = set(), []
    for way, part in angle.groupby("direction", sort=False):
        worst = part.groupby("draw").angle.max()
        within.add(claims.below(worst, limit))
        texts.append(f"{worst.max():.2f} deg {way}{claims.against(worst, limit)}")
    return within.pop() if len(within) == 1 else None, f"worst {', '.join(texts)}"


def _while_hung(rows: DataFrame) -> claims.Verdict:
    """Whether the error's standard deviation is larger in phase III than in every other one."""
    rows = rows.assign(rmse=np.degrees(rows.deviation))
    each = {"load": unique(rows, "load"), "phase": JUDGED, "method": (m.PAPERS_BEST,)}
    return claims.ordered({}, {"phase": _HAND}, each)(rows)


def _as_table_3(rows: DataFrame) -> claims.Verdict:
    """Whether errors are those of Table 3, of the direction in which they come nearer."""
    verdicts: list[claims.Verdict] = []
    for way, part in rows.groupby("direction", sort=False):
        pairs = []
        for mass, phase in product(unique(part, "mass"), JUDGED):
            load = f"{1e3 * mass:.0f}g phase {phase}"
            there = reported("yan2020", "3", f"load={load}", m.PAPERS_BEST)
            sizes = claims.by_session(part, method=m.PAPERS_BEST, mass=mass, phase=phase)
            pairs += [(f"{load}, {way}", sizes, there["rms"])] if there else []
        verdicts += [claims.matches(pairs)] if pairs else []
    order, none = (True, "more", None, False), (None, "no such weight")
    return min(verdicts, key=lambda verdict: order.index(verdict[0]), default=none)


LOADED_CLAIMS: Final = claims.statements(
    "forceps-loaded",
    {
        "phase-1": partial(_within, phase="I", limit=0.2),
        "phase-2": partial(_within, phase="II", limit=0.2),
        "phase-3": _while_hung,
        "phase-4": partial(_within, phase="IV", limit=0.5),
        "light": partial(_within, phase="", limit=0.5, lightest=_LIGHT),
        "table-3": _as_table_3,
    },
)


def _loaded_figures(results: Results, methods: Sequence[str], name: str) -> dict[str, Figure]:
    """Draw figure 9: angles by the encoder and one method, and the errors of each method."""
    first = select(results.rows, draw=0).drop_duplicates("part")
    ways = [(f"load {way}", group) for way, group in first.groupby("direction", sort=False)]

    def panel(group: DataFrame, title: str, *keys: str, step: float = 0.0) -> Panel:
        curves = []
        for place, (part, mass) in enumerate(group[["part", "mass"]].to_numpy()):
            arrays = results.arrays[part]
            for key, style in zip(keys, ("-", ":"), strict=False):
                values = arrays[key] if step else arrays[key] - arrays["truth"]
                # The encoder's steps of 0.088 deg would hide everything else.
                shown = _averaged(arrays["t"], np.degrees(values) + step * place)
                label = f"{1e3 * mass:g} g" if key == keys[0] else ""
                curves.append(Curve(arrays["t"], shown, label, f"C{place}", style))
        unit, shade = "jaw [deg]" if step else "error [deg]", tuple(arrays["released"])
        return Panel(curves, "time [s]", unit, title, shade=shade)

    angles = [panel(group, way, "truth", methods[0], step=SHIFT) for way, group in ways]
    errors = [
        [panel(group, f"{m.TITLES[method]}, {way}", method) for way, group in ways]
        for method in methods
    ]
    captions = (
        f"Jaw by the reference encoder and, dotted, by {m.TITLES[methods[0]]}; each weight "
        f"{SHIFT:g} deg above the one before. Grey: the hand lets go.",
        f"Errors while weights are hung on the jaw, means over {_AVERAGE:g} s, each panel with a "
        "scale of its own; grey: the hand lets go.",
    )
    a, b = (f"yan2020 figure 9({letter}), specimen {name}" for letter in "ab")
    height = 2.3 * len(errors) + 1.0
    return {
        "forceps-loaded-angles": Figure(a, (angles,), captions[0], height=4.8, legend=True),
        "forceps-loaded": Figure(b, errors, captions[1], height=height, legend=True),
    }


def _averaged(t: Array, values: Array) -> Array:
    """Centred mean (n,) over `_AVERAGE`."""
    weights = np.ones(max(1, round(_AVERAGE / float(t[1] - t[0]))))
    count = np.convolve(np.ones_like(values), weights, "same")
    return np.asarray(np.convolve(values, weights, "same") / count)
