"""`truejoint show`: describe a file; `robots`, `estimators`, `datasets`: what there is by name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import truejoint
from truejoint.cli.console import out, print_facts, print_table, progress, shortened
from truejoint.cli.options import Result, get_robot
from truejoint.cli.recording_options import Files
from truejoint.errors import RecordingError
from truejoint.files import head_of
from truejoint.robots.catalogue import DEFAULT
from truejoint.units import display_unit

_LABORATORY: Final = ("shoulder", "elbow", "insertion")  # columns of its trajectories
_ANY_HOMING: Final = "any one, the first that the loop is told: training named none"
_MOST: Final = 12  # items of a list that are shown
# What stands in a model's summary, or beside it in other words.
_TOLD = frozenset({"estimator", "rows", "duration", "fit_seconds", "homing_ids"})


def show(name: str, files: Files) -> Result:
    """Say what a file or a data set is, what it holds and where it comes from."""
    path = Path(name)
    if name.partition(":")[0] in truejoint.robots.robot_names() and not path.exists():
        return robots(name)
    if name in truejoint.recordings.datasets.DATASETS and not path.exists():
        return datasets(name)
    if files == Files(robot=files.robot) and _is_trajectory(path):
        arm = get_robot(files.robot or DEFAULT)
        return tell_trajectory(truejoint.motion.read_trajectory(path), arm)
    if is_model(path):
        described = [model_facts(path)]
    else:
        described = [recording_facts(recording) for recording in files.find([name])()]
    for facts, columns in described:
        print_facts(name, _texts({k: v for k, v in facts.items() if k != "identified"}))
        rows = [
            [key, unit, f"{value:.4g}", f"{deviation:.2g}"]
            for key, (value, deviation, unit) in facts.get("identified", {}).items()
        ]
        if rows:
            print_table(("identified", "unit", "value", "deviation"), rows)
        header = ("column", "unit", "lowest", "highest", "missing")
        print_table(header, [_column_texts(column) for column in columns])
    return Result({"shown": [{**facts, "columns": columns} for facts, columns in described]})


def robots(name: str | None = None) -> Result:
    """List robots; with a name, show its joints, their limits, and what a column map may name.

    Any other robot is a file (docs/robots.md), which goes wherever a name goes.
    """
    from truejoint.recordings.read.map_sketch import QUANTITIES

    if name is None:
        every = [truejoint.get_robot(each) for each in truejoint.robots.robot_names()]
        rows = [(robot.name, ", ".join(robot.joint_names)) for robot in every]
        print_table(("robot", "joints"), rows, numbers=False)
        return Result({"robots": [robot.to_dict() for robot in every]})
    robot, limits = get_robot(name), []
    for joint in robot.joints:
        unit = display_unit(joint.unit)
        ends = (f"{limit * unit.scale:.4g}" for limit in (joint.lower, joint.upper))
        limits.append((joint.name, joint.kind, *ends, unit.name))
    print_facts(robot.title, robot.summary().items())
    print_table(("joint", "kind", "lower", "upper", "unit"), limits)
    if len(arms := truejoint.robots.arm_names(name.partition(":")[0])) > 1:
        out.print(f"Arms: {', '.join(arms)}; one is named as {robot.name}:{arms[0]}.")
    out.print(f"A column map names t and <quantity>/<joint>; quantities: {', '.join(QUANTITIES)}.")
    if unused := [channel for channel in robot.channels if channel not in robot.joint_names]:
        out.print(
            f"Channels of the state without a joint, which it may name too: {', '.join(unused)}."
        )
    return Result({"robot": robot.to_dict(), "quantities": list(QUANTITIES)})


def estimators(name: str | None = None) -> Result:
    """List estimators; with a name, show what it is and its parameters for `--set`.

    Take `-e auto`, the default, unless you compare methods: it tries those that are marked.
    """
    from truejoint.estimators.registry import PRESETS, Preset, estimator_names

    foreign = Preset("", "of an installed package")
    presets = {title: PRESETS.get(title, foreign) for title in estimator_names()}
    facts = {
        title: {"what": each.what, "sees": each.sees, "auto": "yes" if each.is_tried else "no"}
        for title, each in presets.items()
    }
    if name is None:
        rows = [(title, *values.values()) for title, values in facts.items()]
        print_table(("estimator", "what", "sees", "auto tries it"), rows, numbers=False)
        return Result({"estimators": facts})
    defaults = truejoint.estimators.get_estimator(name).get_params(deep=False)
    parameters = {parameter: str(value) for parameter, value in defaults.items()}
    print_facts(name, facts[name].items())
    print_table(("parameter", "default"), parameters.items(), numbers=False)
    return Result({"name": name, **facts[name], "parameters": parameters})


def _is_trajectory(path: Path) -> bool:
    """Whether a file begins as our trajectories do, or with the laboratory's three numbers."""
    first = head_of(path, 1000).partition(b"\n")[0] if path.suffix == ".csv" else b""
    if first.startswith(b"# truejoint trajectory"):
        return True
    with suppress(ValueError):
        return len([float(field) for field in first.split(b",")]) == len(_LABORATORY)
    return False


def tell_trajectory(
    trajectory: truejoint.motion.Trajectory, robot: truejoint.robots.Robot
) -> Result:
    """Print range, path length and duration of a trajectory."""
    q, duration = trajectory.positions, truejoint.motion.nominal_duration(trajectory, robot)
    path_length = abs(q[1:] - q[:-1]).sum(axis=0)
    ranges = {"lower": q.min(axis=0), "upper": q.max(axis=0), "path_length": path_length}
    rows = []
    for name, *values in zip(trajectory.joints, *ranges.values(), strict=True):
        unit = display_unit(robot.joint(name).unit)
        rows.append((name, *(f"{value * unit.scale:.2f}" for value in values), unit.name))
    print_table(("joint", "from", "to", "path", "unit"), rows, title=trajectory.name)
    out.print(f"{duration / 60:.1f} min at the speed caps of {robot.title}")
    plain = {name: values.tolist() for name, values in ranges.items()}
    about = {"name": trajectory.name, "joints": list(trajectory.joints)}
    return Result({**about, **plain, "duration": duration})


def is_model(path: Path) -> bool:
    """Whether a file begins as a safetensors file does: a length, then JSON."""
    return head_of(path, 9)[8:] == b"{"


def model_facts(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Tell what a model is, and the signals of a sample in order with their trained ranges."""
    from truejoint.evaluation.scoring import learnt_texts
    from truejoint.recordings.bounded_file import sha256_of

    model = truejoint.read_calibration(path)
    ranges = zip(model.feature_set.features, model.lower, model.upper, strict=True)
    trained = {f.signal: (low, high) for f, low, high in ranges if f.operation == "value"}
    columns = [_column(name, model.units[name], trained.get(name, ())) for name in model.signals]
    loads = {session.load for session in model.origin.sessions if session.load >= 0.0}
    learnt = [condition for session in model.origin.sessions for condition in session.conditions]
    facts = {
        **model.summary(),
        "learnt": learnt_texts(learnt, model.units),
        "features": ", ".join(model.feature_set.names),
        "sample": ", ".join(model.loop_signals),
        "homings": list(model.origin.homing_ids),
        "loads": ", ".join(f"{1000.0 * load:g} g" for load in sorted(loads)),
        **{key: value for key, value in model.facts.items() if key not in _TOLD},
        "sha256": sha256_of(path),
    }
    return facts, columns


def recording_facts(recording: truejoint.Recording) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Tell what a recording is, where it comes from, and the range of each column."""
    provenance = recording.provenance.to_dict()
    del provenance["robot"], provenance["arm"], provenance["source"]
    units, table = recording.units.items(), recording.table
    columns = [_column(name, unit, table[name].to_numpy()) for name, unit in units]
    return {**recording.summary(), **provenance}, columns


def _column(name: str, unit: str, values: Iterable[float]) -> dict[str, Any]:
    """Give the range of values (n,), and how many are not finite."""
    import numpy as np

    numbers = np.asarray(values, dtype=float)
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
    missing = len(numbers) - len(finite)
    return {"column": name, "unit": unit, "lowest": low, "highest": high, "missing": missing}


def _column_texts(column: Mapping[str, Any]) -> list[str]:
    unit, bounds = display_unit(column["unit"]), (column["lowest"], column["highest"])
    low, high = ("-" if value is None else f"{value * unit.scale:.4g}" for value in bounds)
    return [column["column"], unit.name, low, high, str(column["missing"] or "-")]


def _texts(facts: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Facts as text; of what is nested in them each a line, of a long list its beginning.

    Settings may hold a whole mechanism, of which begin and end are enough beside ``--json``.
    """
    for key, value in facts.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}.{name}", text) for name, text in _texts(value))
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            yield key, f"{len(value)}"
        elif key == "homings" and not value:
            yield key, _ANY_HOMING
        elif isinstance(value, list) and value:
            more = f" and {len(value) - _MOST} more (--json)" if len(value) > _MOST else ""
            yield key, ", ".join(map(str, value[:_MOST])) + more
        elif value not in (None, "", []):
            text = f"{value:.6g}" if isinstance(value, float) else str(value)
            yield key, shortened(text, 300) if key == "settings" else text


def datasets(name: str | None = None, fetch: bool = False) -> Result:
    """List public recordings of real joints; with a name, describe a data set or fetch it."""
    sets = truejoint.recordings.datasets
    if name is None:
        listed, rows = [], []
        for each in sets.DATASETS.values():
            facts = _dataset_facts(each, each.recordings)
            size, licence = f"{each.size / 1e6:.1f}", each.licence or "none stated"
            rows.append((each.name, each.title, size, licence, "yes" if facts["here"] else "no"))
            listed.append(facts)
        print_table(("name", "what", "MB", "licence", "here"), rows, numbers=False)
        return Result({"datasets": listed})
    name, _, pattern = name.partition(":")
    dataset = sets.get_dataset(name)
    if not fetch:
        facts = _dataset_facts(dataset, dataset.match(pattern or "*"))
        texts = {k: "\n".join(v) if isinstance(v, list) else str(v) for k, v in facts.items()}
        print_facts(dataset.title, texts.items())
        return Result(facts)
    with progress(f"Fetching {name} from {dataset.repository}") as done:
        folder = sets.fetch(name, pattern or "*", progress=done)
    out.print(f"{name} is in {folder}")
    return Result({"name": name, "folder": str(folder)})


def _dataset_facts(
    dataset: truejoint.recordings.datasets.Dataset, names: Iterable[str]
) -> dict[str, Any]:
    """Describe a data set: its source, how to cite it, recordings of these names, how to judge."""
    return {
        "name": dataset.name,
        "robot": dataset.robot,
        "upstream": f"{dataset.repository} @ {dataset.commit}",
        "licence": dataset.licence or "none stated: evaluate it, do not pass it on",
        "notice": dataset.notice,
        "citation": dataset.citation,
        "here": _is_here(dataset),
        "recordings": list(names),
        "features": list(dataset.features),
        "splits": [split.name for split in dataset.splits],
    }


def _is_here(dataset: truejoint.recordings.datasets.Dataset) -> bool:
    with suppress(RecordingError):
        return bool(truejoint.recordings.datasets.locate(dataset.name))
    return False
