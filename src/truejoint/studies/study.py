"""What a study is: an experiment as data, which one runner computes and one page shows.

Nothing heavy is imported here, so that studies can be listed and completed at once.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, cast, get_args

from truejoint.errors import StudyError, unknown
from truejoint.toml_file import shipped_table

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from truejoint.drawing import Figure
    from truejoint.tables import Table

Scalar = int | float | str
Value = Scalar | tuple[Scalar, ...]
Preset = Literal["small", "full"]
Holds = bool | None | Literal["more"]
Row = Mapping[str, Any]
"""Flat JSON values by column."""
Rows = list[Row]
Plain = Mapping[str, Mapping[str, Any]]
"""A specimen as plain values, which `Part.arguments` can hold."""

PRESETS: Final = get_args(Preset)
VERDICTS: Final = ("holds", "holds more strongly", "does not", "cannot be told")
MAX_SEED: Final = 2**31 - 1
LEVEL: Final = 0.95
"""At which a difference is told."""
TESTS: Final = {
    "t": "Student's t", "share": "exact interval of a share", "variance": "F test of variances",
    "stretches": "interval over stretches",
}  # fmt: skip
"""Tests behind verdicts, by their name in ``claims.toml``."""
_REPETITIONS: Final = ("session", "draw", "specimen")
_OF_ORDERS: Final = ("low", "high", "each", "share")


@dataclass(frozen=True)
class PartResult:
    """Result of one part: tidy `rows`, flat JSON values in SI, and `arrays` by name.

    `sources` are digests of the files that made it, by name; the runner notes them.

    Examples
    --------
    >>> PartResult([{"method": "linear", "rms": 0.01}]).rows[0]["rms"]
    0.01
    """

    rows: Sequence[Row]
    arrays: "Mapping[str, NDArray[Any]]" = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a study that is computed by itself, stored and resumed.

    Attributes
    ----------
    key : str
        Its name in the study, which is part of a file's.
    compute : callable
        Pure function of a module, which another process can import: rows, or a `PartResult`.
    arguments : mapping
        Arguments, JSON values: everything, seeds included, that its result depends on.
    labels : mapping
        Columns that its rows get, such as the specimen; the result does not depend on them.

    Examples
    --------
    >>> study = get_study("forceps-unloaded")
    >>> [part.key for part in study.parts(study.settings("small"))]
    ['unloaded-0', 'unloaded-1', 'unloaded-2']
    """

    key: str
    compute: Callable[..., Rows | PartResult]
    arguments: Mapping[str, Any]
    labels: Row = field(default_factory=dict)


@dataclass(frozen=True)
class Option:
    """Setting of one study, beside preset and seed.

    Attributes
    ----------
    name, meaning : str
        The name ends in a unit where it is not SI.
    default, small : int, float, str or tuple of them
        Its kind is the kind of every value; a tuple is not empty. The preset ``small`` may have
        another default.
    positive : bool
        Whether it must be above 0.

    Examples
    --------
    >>> Option("masses_g", (30.0, 50.0), "weights [g]").parse("100, 200")
    (100.0, 200.0)
    """

    name: str
    default: Value
    meaning: str
    small: Value | None = None
    positive: bool = False

    def parse(self, value: object) -> Value:
        """Value of its text, tuples with commas, or of itself; raises StudyError."""
        try:
            if not isinstance(self.default, tuple):
                return _like(self.default, value)
            items = value.split(",") if isinstance(value, str) else cast("Iterable[object]", value)
            values = tuple(_like(self.default[0], item) for item in items)
            if len(values) == len(set(values)) > 0:
                return values
        except (TypeError, ValueError):
            pass
        raise StudyError(
            f"{self.name}={value!s:.60}: write it like {shown(self.default)}, each once: "
            f"{self.meaning}"
        )


def shown(value: Value) -> str:
    """Text of an option's value, as `Option.parse` reads it."""
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _like(kind: Scalar, value: object) -> Scalar:
    """`value` as the kind of number or text that `kind` is; raises ValueError."""
    text = str(value).strip()
    read = type(kind)(text)
    if not text or (isinstance(read, float) and not math.isfinite(read)):
        raise ValueError(text)
    return read


@dataclass(frozen=True)
class Settings:
    """All that is asked of a study; ``settings["count"]`` is the value of an option.

    Examples
    --------
    >>> get_study("forceps-unloaded").settings("small", seed=3)["specimen"]
    'A'
    """

    preset: Preset
    seed: int
    options: Mapping[str, Value]

    def __getitem__(self, option: str) -> Any:
        return self.options[option]

    def check_names(self, kind: str, option: str, choices: Collection[str]) -> None:
        """Raise StudyError naming the first name in an option that is not one of the choices."""
        names = self[option]
        for name in (names,) if isinstance(names, str) else names:
            if name not in choices:
                raise StudyError(unknown(kind, name, choices))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, options as texts."""
        options = {name: shown(value) for name, value in self.options.items()}
        return {"preset": self.preset, "seed": self.seed, "options": options}


@dataclass(frozen=True, eq=False)
class Results:
    """Results of all parts of a study.

    Attributes
    ----------
    settings : Settings
    rows : DataFrame
        Tidy rows of all parts: the part's key in the column ``part``, its labels, its values in SI.
    arrays : mapping
        Arrays of each part by its key.

    Examples
    --------
    >>> settings = truejoint.studies.get_study("forceps-unloaded").settings("small")
    >>> len(Results.of(settings, [], {}).arrays)
    0
    """

    settings: Settings
    rows: "DataFrame"
    arrays: "Mapping[str, Mapping[str, NDArray[Any]]]"

    @classmethod
    def of(
        cls, settings: Settings, parts: Sequence[Part], results: Mapping[str, PartResult]
    ) -> "Results":
        """Put the results of parts, by key, together."""
        from pandas import DataFrame  # noqa: PLC0415  # a list of studies needs no arithmetic

        own = [(part, results[part.key]) for part in parts]
        rows = [{"part": part.key, **part.labels, **row} for part, of in own for row in of.rows]
        return cls(settings, DataFrame(rows), {part.key: of.arrays for part, of in own})


@dataclass(frozen=True)
class Claim:
    """Statement of a paper, whether it `holds` here (None: cannot be told), and what was `found`.

    ``"more"``: it holds, and more strongly than it is stated. `on` names what it was judged on,
    where that is one of several. A `flaw` is stated of the paper's own method or robot: where it
    does not hold, what is here is better. `number` is that of `CLAIMS`, and `test` says which test
    decided, at which level and over how many repetitions.

    Examples
    --------
    >>> Claim("the error stays below 1 deg", "yan2020", True, "0.4 deg").verdict
    'holds'
    """

    text: str
    source: str
    holds: Holds
    found: str
    on: str = ""
    flaw: bool = False
    number: str = ""
    test: str = ""

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`."""
        return VERDICTS[(True, "more", False, None).index(self.holds)]

    @property
    def look(self) -> str:
        """Colour of the verdict: ``"pass"``, ``"warn"`` or ``"fail"``."""
        better = self.holds is False and self.flaw
        return "pass" if self.holds else "warn" if self.holds is None or better else "fail"


class Statement(NamedTuple):
    """Statement of a paper: an entry of ``claims.toml``, which says what each field means.

    `judge` turns what was found into verdict and text.

    Examples
    --------
    >>> below = Statement("below 1 deg", "yan2020", judge=lambda rms: (rms < 1.0, f"{rms} deg"))
    >>> below.judged(0.4).verdict
    'holds'
    """

    text: str
    source: str
    study: str = ""
    test: str = "t"
    flaw: bool = False
    number: str = ""
    order: Mapping[str, Any] | None = None
    judge: Callable[[Any], tuple[Holds, str]] = lambda _: (None, "")

    def claim(self, holds: Holds, found: str, on: str = "", count: int = 0) -> Claim:
        """Claim with a verdict, told over `count` repetitions."""
        found += "; better than stated" if holds is False and self.flaw else ""
        test = f"{TESTS[self.test]} at {100 * LEVEL:.0f} %" + (f", n = {count}" if count else "")
        return Claim(self.text, self.source, holds, found, on, self.flaw, self.number, test)

    def judged(self, found: Any, on: str = "") -> Claim:
        """Claim on what was found, on one of several where that has a name.

        Repetitions are the sessions, draws or specimens of rows.
        """
        columns = [name for name in _REPETITIONS if name in getattr(found, "columns", ())]
        count = found[columns[0]].nunique() if columns else 0
        return self.claim(*self.judge(found), on, count)


@dataclass(frozen=True)
class Summary:
    """Summary of a study's parts: tables, claims, and by file name figures.

    Examples
    --------
    >>> Summary().tables
    ()
    """

    tables: "Sequence[Table]" = ()
    figures: "Mapping[str, Figure]" = field(default_factory=dict)
    claims: Sequence[Claim] = ()


@dataclass(frozen=True)
class Study:
    """An experiment.

    Attributes
    ----------
    name : str
        Name that a user types.
    title : str
        One line on what it asks.
    source : str
        Paper and table or figure that it repeats; empty for one of ours.
    module : str
        Module in which ``parts(settings)``, a sequence of `Part`, and ``summarise(results)``, a
        `Summary` of `Results`, are defined; ``"module:name"`` where these are ``name_parts`` and
        ``name_summary``, as in a module of several studies.
    options : tuple of Option

    Examples
    --------
    >>> get_study("forceps-unloaded").settings("small").to_dict()["options"]["specimen"]
    'A'
    """

    name: str
    title: str
    source: str
    module: str
    options: tuple[Option, ...] = ()

    def settings(
        self, preset: str = "full", seed: int = 0, options: Mapping[str, object] | None = None
    ) -> Settings:
        """Check settings; options that are not given are the preset's.

        Raises StudyError if there is no such preset or option, or a value is of the wrong kind.
        """
        if preset not in PRESETS:
            raise StudyError(f"no preset {preset!r:.60}; choose one of {', '.join(PRESETS)}")
        if not 0 <= seed <= MAX_SEED:
            raise StudyError(f"seed {seed!r:.60}; it must be 0 to {MAX_SEED}")
        by_name = {option.name: option for option in self.options}
        values = {
            name: option.small if preset == "small" and option.small else option.default
            for name, option in by_name.items()
        }
        for name, value in (options or {}).items():
            if name not in by_name:
                names = "; ".join(f"{o.name} ({o.meaning})" for o in self.options) or "none"
                raise StudyError(f"{self.name} has no option {name!r:.60}; it has {names}")
            values[name] = by_name[name].parse(value)
            if by_name[name].positive and not cast("float", values[name]) > 0:
                raise StudyError(f"{name}={values[name]}; it must be above 0")
        return Settings(cast("Preset", preset), seed, values)

    def parts(self, settings: Settings) -> Sequence[Part]:
        """Parts that the settings ask for; raises StudyError where one cannot be made of them."""
        return cast("Sequence[Part]", self._function("parts", "parts")(settings))

    def summarise(self, results: Results) -> Summary:
        """Tables, figures and claims of the results of all parts."""
        return cast("Summary", self._function("summarise", "summary")(results))

    def _function(self, alone: str, among: str) -> Callable[[Any], Any]:
        module, _, name = self.module.partition(":")
        function: Callable[[Any], Any]
        function = getattr(import_module(module), f"{name}_{among}" if name else alone)
        return function


def _study(name: str, row: Mapping[str, Any], shared: Mapping[str, Any]) -> Study:
    """Study of a row of the catalogue; an option's own values go before the `shared` ones."""
    own = [{"name": each} if isinstance(each, str) else each for each in row["options"]]
    options = tuple(Option(**{**shared.get(each["name"], {}), **each}) for each in own)
    made = {"name": name, "module": f"{__package__}.{row['module']}", "options": options}
    return Study(**{"source": "", **row, **made})


def _stated(table: Mapping[str, Any]) -> Iterator[tuple[str, Statement]]:
    """Claims by key, each with the letter of its paper and its place among the paper's."""
    counts = Counter[str]()
    for key, row in table.items():
        letter = {"yan2020": "Y", "ours": "O"}.get(row["source"].partition(",")[0], "P")
        counts[letter] += 1
        order = {name: value for name, value in row.items() if name in _OF_ORDERS}
        about = {name: value for name, value in row.items() if name not in order}
        yield key, Statement(**about, number=f"{letter}{counts[letter]}", order=order or None)


CLAIMS: Final = dict(_stated(shipped_table(__package__, "claims.toml")))
"""Every claim of the papers that a study judges, by key, of `claims.toml`."""
_CATALOGUE: Final = shipped_table(__package__, "catalogue.toml")
STUDIES: Final = {
    name: _study(name, row, _CATALOGUE["options"]) for name, row in _CATALOGUE["studies"].items()
}
"""By name, of `catalogue.toml`, in the order in which they are listed."""


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
