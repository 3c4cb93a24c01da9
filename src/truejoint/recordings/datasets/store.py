"""Where the public data sets are on this machine, and how they get there."""

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, Final

import pooch
import requests

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import sha256_of
from truejoint.recordings.datasets.catalogue import Dataset, DatasetFile, get_dataset
from truejoint.recordings.read.reading import read_recording
from truejoint.recordings.table.recording import Recording

DATA_VARIABLE: Final = "TRUEJOINT_DATA"
"""Environment variable: a folder with one folder per data set, files as upstream or in gzip."""

_TIMEOUT: Final = 30.0
_RETRIES: Final = 1
_CHUNK: Final = 1024


def cache_folder() -> Path:
    """Folder that `fetch` fills, the user's cache."""
    return Path(pooch.os_cache("truejoint"))


def data_folders() -> tuple[Path, ...]:
    """Folders that are searched for data sets, first the one of `DATA_VARIABLE`.

    Raises RecordingError if the variable names something that is no folder.
    """
    if stated := os.environ.get(DATA_VARIABLE, ""):
        if not Path(stated).is_dir():
            raise RecordingError(f"{DATA_VARIABLE}={stated}: is not a folder; correct or unset it")
        return Path(stated), cache_folder()
    project = Path(__file__).parents[4]
    beside = project.parent / "shared" / "data"
    is_project = (project / "pyproject.toml").is_file() and beside.is_dir()
    return (beside, cache_folder()) if is_project else (cache_folder(),)


def locate(name: str) -> Path:
    """Folder of a data set on this machine: in the first of `data_folders` that has some of it.

    Parameters
    ----------
    name : str
        One of `DATASETS`.

    Raises
    ------
    RecordingError
        If there is no such data set, or no copy of it here; the message says how to get one.

    Examples
    --------
    >>> locate("davinci_grasper_umn")  # doctest: +SKIP
    """
    dataset = get_dataset(name)
    for folder in data_folders():
        if any(path.is_file() for path in (folder / name).rglob("*")):
            return folder / name
    raise RecordingError(
        f"{name}: no copy on this machine; run 'truejoint datasets {name} --fetch' "
        f"({dataset.size / 1e6:.0f} MB) or set {DATA_VARIABLE} to a folder that has it"
    )


def fetch(
    name: str, pattern: str = "*", *, progress: Callable[[float], None] | None = None
) -> Path:
    """Get a data set, or part of it, from its upstream repository; gives its folder in the cache.

    A file that is there with the right hash is not fetched again. Each file is checked against
    its SHA-256 before it is put in place.

    Parameters
    ----------
    name : str
        One of `DATASETS`.
    pattern : str
        Shell pattern of the recordings to get.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    RecordingError
        If there is no such data set or recording, the network fails, or a file is not the one
        that is known.

    Examples
    --------
    >>> fetch("davinci_grasper_umn")  # doctest: +SKIP
    """
    dataset = get_dataset(name)
    wanted = [file for one in dataset.match(pattern) for file in dataset.recordings[one]]
    folder = cache_folder() / name
    store = pooch.create(
        path=folder,
        base_url="",
        registry={file.name: f"sha256:{file.sha256}" for file in wanted},
        urls={file.name: dataset.url(file) for file in wanted},
        retry_if_failed=_RETRIES,
    )
    total, done = sum(file.size for file in wanted), 0
    pooch.get_logger().setLevel(logging.ERROR)

    def report(before: int, taken: int) -> None:
        if progress:
            progress((before + taken) / total)

    for file in wanted:
        _fetch_one(store, dataset, file, partial(report, done))
        done += file.size
        report(done, 0)
    return folder


def read_dataset(
    name: str, pattern: str = "*", *, progress: Callable[[float], None] | None = None
) -> list[Recording]:
    """Read recordings of a data set that is on this machine, in the order of the catalogue.

    The session of each is its name in the data set, its source the upstream place.

    Parameters
    ----------
    name : str
        One of `DATASETS`.
    pattern : str
        Shell pattern of the recordings' names, for instance ``"Tool_4_Maryland_L_4/3?"``.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    RecordingError
        If there is no copy here, a file is missing or is not the one that is known upstream.

    Examples
    --------
    >>> read_dataset("davinci_grasper_umn", "*_500*")  # doctest: +SKIP
    """
    dataset = get_dataset(name)
    wanted = dataset.match(pattern)
    folder = locate(name)
    recordings = []
    for recording in wanted:
        files, layout = dataset.recordings[recording], dataset.layout(recording)
        paths = [_require_upstream(dataset, folder, file) for file in files]
        alone = len(paths) == 1
        result = read_recording(
            paths[0] if alone else paths[0].parent,
            None if alone else "arrays",
            column_map=layout["map"],
            session=recording,
            homing_id=recording if "own_zero" in layout else "",
            notes=layout.get("notes", ""),
        )
        repository, commit, upstream = dataset.origin(files[0])
        path = upstream if alone else PurePosixPath(upstream).parent
        origin = replace(result.provenance, source=f"{repository}@{commit[:8]}:{path}")
        if "nominal_hz" in layout:
            rates = dict.fromkeys(("state", "truth"), float(layout["nominal_hz"]))
            origin = replace(origin, rates=rates)
        recordings.append(replace(result, provenance=origin))
        if progress:
            progress(len(recordings) / len(wanted))
    return recordings


def _require_upstream(dataset: Dataset, folder: Path, file: DatasetFile) -> Path:
    """Copy of a file, plain or in gzip; raises RecordingError if it is not the upstream one."""
    plain = folder / file.name
    path = plain if plain.is_file() else folder / f"{file.name}.gz"
    if not path.is_file():
        raise RecordingError(
            f"{plain}: is missing; run 'truejoint datasets {dataset.name} --fetch'"
        )
    if sha256_of(path) != file.sha256:
        repository, commit, _ = dataset.origin(file)
        raise RecordingError(
            f"{path}: is not the file of {repository} at {commit[:8]} "
            "(its SHA-256 differs); fetch it again"
        )
    return path


def _fetch_one(
    store: Any, dataset: Dataset, file: DatasetFile, report: Callable[[int], None]
) -> None:
    """Fetch a file; `report` is called with the bytes that have arrived."""

    def download(url: str, target: str, _: Any) -> None:
        taken = 0
        stream = requests.get(url, stream=True, timeout=_TIMEOUT)
        with stream as answer, Path(target).open("wb") as part:
            answer.raise_for_status()
            for chunk in answer.iter_content(_CHUNK):
                taken += part.write(chunk)
                if taken > file.size:
                    raise ValueError  # as pooch does for a wrong hash
                report(taken)

    try:
        # Not by pooch, which fails where another process makes the same folder meanwhile.
        (store.abspath / file.name).parent.mkdir(parents=True, exist_ok=True)
        store.fetch(file.name, downloader=download)
    except requests.RequestException as error:
        raise RecordingError(
            f"{dataset.url(file)}: cannot be fetched ({type(error).__name__}); check the network, "
            f"or copy the data set yourself and set {DATA_VARIABLE}"
        ) from None
    except ValueError:  # pooch has removed the file
        raise RecordingError(
            f"{dataset.url(file)}: is not the file that was published, of {file.size} bytes with "
            f"SHA-256 {file.sha256[:16]}...; try again later"
        ) from None
    except OSError as error:
        raise RecordingError(f"{file.name}: cannot be written to the cache ({error})") from None
