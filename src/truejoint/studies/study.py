"""What a study is: an experiment as data, which one runner computes and one page shows.

Nothing heavy is imported here, so that studies can be listed and completed at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Literal, cast, get_args

from truejoint.errors import StudyError, unknown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from truejoint.drawing import Figure
    from truejoint.recordings import Recording
    from truejoint.tables import Table

Scalar = int | float | str
Value = Scalar | tuple[Scalar, ...]
Preset = Literal["small", "full"]

PRESETS: Final = get_args(Preset)
MAX_SEED: Final = 2**31 - 1


@dataclass(frozen=True)
class PartResult:
    """What one part found: `numbers`, JSON values in SI, and `arrays` by name.

    Examples
    --------
    >>> PartResult({"rms": 0.01}).numbers["rms"]
    0.01
    """

    numbers: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a study that is computed apart from the others, kept and resumed.

    Attributes
    ----------
    key : str
        Its name in the study, which is part of a file's.
    compute : callable
        Pure function of a module, which another process can import.
    arguments : mapping
        What it is called with, JSON values: everything, seeds included, that its result depends on.

    Examples
    --------
    >>> study = get_study("forceps-unloaded")
    >>> [part.key for part in study.parts(study.settings("small"))]
    ['unloaded']
    """

    key: str
    compute: Callable[..., PartResult]
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Option:
    """What a user may set of one study, beside preset and seed.

    Attributes
    ----------
    name, meaning : str
        The name ends in a unit where it is not SI.
    default, small : int, float, str or tuple of them
        Its kind is the kind of every value; a tuple is not empty. The preset ``small`` may have a
        default of its own.

    Examples
    --------
    >>> Option("masses_g", (30.0, 50.0), "weights [g]").parse("100, 200")
    (100.0, 200.0)
    """

    name: str
    default: Value
    meaning: str
    small: Value | None = None

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

    def to_dict(self) -> dict[str, Any]:
        """Plain values, options as texts."""
        options = {name: shown(value) for name, value in self.options.items()}
        return {"preset": self.preset, "seed": self.seed, "options": options}


def check_counts(settings: Settings, *names: str) -> None:
    """Raise StudyError naming the first option that is not above 0."""
    for name in names:
        if not settings[name] > 0:
            raise StudyError(f"{name}={settings[name]}; it must be above 0")


def check_names(kind: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Raise StudyError naming the first of `names` that is not known."""
    for name in names:
        if name not in known:
            raise StudyError(unknown(kind, name, known))


@dataclass(frozen=True)
class Claim:
    """What a paper states, whether it `holds` here (None: cannot be told), and what was `found`.

    `on` names what it was judged on, where that is one of several.

    Examples
    --------
    >>> Claim("the error stays below 1 deg", "yan2020", True, "0.4 deg").verdict
    'agrees'
    """

    text: str
    source: str
    holds: bool | None
    found: str
    on: str = ""

    @property
    def verdict(self) -> str:
        """``"agrees"``, ``"does not agree"`` or ``"cannot be told"``."""
        return {True: "agrees", False: "does not agree", None: "cannot be told"}[self.holds]


@dataclass(frozen=True)
class Statement:
    """What a paper states, before it is judged: `judge` turns what was found into verdict and text.

    Examples
    --------
    >>> stated = Statement("below 1 deg", "yan2020", lambda rms: (rms < 1.0, f"{rms} deg"))
    >>> stated.judged(0.4).verdict
    'agrees'
    """

    text: str
    source: str
    judge: Callable[[Any], tuple[bool | None, str]]

    def judged(self, found: Any, on: str = "") -> Claim:
        """Claim on what was found, on one of several where that has a name."""
        return Claim(self.text, self.source, *self.judge(found), on)


@dataclass(frozen=True)
class Summary:
    """What a study makes of its parts: tables, claims, and by file name figures and recordings.

    Examples
    --------
    >>> Summary().tables
    ()
    """

    tables: Sequence[Table] = ()
    figures: Mapping[str, Figure] = field(default_factory=dict)
    claims: Sequence[Claim] = ()
    recordings: Mapping[str, Recording] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """An experiment.

    Attributes
    ----------
    name : str
        What a user types.
    title : str
        One line on what it asks.
    source : str
        Paper and table or figure that it repeats; empty for one of ours.
    module : str
        Where ``parts(settings)``, a sequence of `Part`, and ``summarise(settings, results)``, a
        `Summary` of `PartResult` by key, are defined.
    options : tuple of Option
    version : int
        Raised when its parts compute something else from the same arguments.

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
    version: int = 1

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
        known = {option.name: option for option in self.options}
        values = {
            name: option.small if preset == "small" and option.small else option.default
            for name, option in known.items()
        }
        for name, value in (options or {}).items():
            if name not in known:
                names = "; ".join(f"{o.name} ({o.meaning})" for o in self.options) or "none"
                raise StudyError(f"{self.name} has no option {name!r:.60}; it has {names}")
            values[name] = known[name].parse(value)
        return Settings(cast("Preset", preset), seed, values)

    def parts(self, settings: Settings) -> Sequence[Part]:
        """Parts that the settings ask for; raises StudyError where one cannot be made of them."""
        return cast("Sequence[Part]", import_module(self.module).parts(settings))

    def summarise(self, settings: Settings, results: Mapping[str, PartResult]) -> Summary:
        """Tables, figures and claims of the results of all parts, by key."""
        return cast("Summary", import_module(self.module).summarise(settings, results))
