"""Where the public data sets are on this machine, and how they get there."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

import pooch
import requests

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import sha256_of
from truejoint.recordings.datasets.catalogue import (
    Dataset,
    DatasetFile,
    DatasetRecording,
    get_dataset,
)
from truejoint.recordings.read.reading import read_recording
from truejoint.recordings.table.recording import Recording

DATA_VARIABLE: Final = "TRUEJOINT_DATA"
"""Environment variable: a folder with one folder per data set, files as upstream or in gzip."""

_TIMEOUT: Final = 30.0
_RETRIES: Final = 1
_CHUNK: Final = 1024


def cache_folder() -> Path:
    """Folder that `fetch` fills, the user's cache.

    Examples
    --------
    >>> cache_folder().name
    'truejoint'
    """
    return Path(pooch.os_cache("truejoint"))


def data_folders() -> tuple[Path, ...]:
    """Folders that are searched for data sets, first the one of `DATA_VARIABLE`.

    Raises
    ------
    RecordingError
        If the variable names something that is no folder.

    Examples
    --------
    >>> cache_folder() in data_folders()
    True
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
        if (folder / name).is_dir():
            return folder / name
    raise RecordingError(
        f"{name}: no copy on this machine; run 'truejoint datasets fetch {name}' "
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
    wanted = [file for recording in dataset.match(pattern) for file in recording.files]
    folder = cache_folder() / name
    store = pooch.create(
        path=folder,
        base_url="",
        registry={file.name: f"sha256:{file.sha256}" for file in wanted},
        urls={file.name: dataset.url(file) for file in wanted},
        retry_if_failed=_RETRIES,
    )
    total, done = sum(file.size for file in wanted), 0
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        for file in wanted:
            _fetch_one(store, dataset, file, _Meter(file.size, done, total, progress))
            done += file.size
            if progress:
                progress(done / total)
    finally:
        logger.setLevel(level)
        _remove_empty(folder)
    return folder


def _remove_empty(folder: Path) -> None:
    """Leave no folder without a file: `locate` would take it for a copy."""
    with suppress(OSError):  # a file, not empty, or another process has been quicker
        for inner in [*folder.iterdir()]:
            _remove_empty(inner)
        folder.rmdir()


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
        recordings.append(_read_one(dataset, folder, recording))
        if progress:
            progress(len(recordings) / len(wanted))
    return recordings


def _read_one(dataset: Dataset, folder: Path, recording: DatasetRecording) -> Recording:
    paths = []
    for file in recording.files:
        plain = folder / file.name
        packed = folder / f"{file.name}.gz"
        path = plain if plain.is_file() else packed
        if not path.is_file():
            raise RecordingError(
                f"{plain}: is missing; run 'truejoint datasets fetch {dataset.name}'"
            )
        if sha256_of(path) != file.sha256:
            repository, commit, _ = dataset.origin(file)
            raise RecordingError(
                f"{path}: is not the file of {repository} at {commit[:8]} "
                "(its SHA-256 differs); fetch it again"
            )
        paths.append(path)
    alone = len(paths) == 1
    path = paths[0] if alone else paths[0].parent
    options = {"column_map": dataset.maps[recording.name]} if recording.name in dataset.maps else {}
    result = read_recording(path, dataset.format or None, session=recording.name, **options)
    repository, commit, upstream = dataset.origin(recording.files[0])
    place = upstream if alone else PurePosixPath(upstream).parent
    source = f"{repository}@{commit[:8]}:{place}"
    return replace(result, provenance=replace(result.provenance, source=source))


class _TooLongError(Exception):
    """More bytes arrive than the file has."""


@dataclass
class _Meter:
    """What pooch tells of its progress on one file, as part of all files."""

    total: int  # pooch sets it to what the server says; the size in the catalogue is what counts
    before: int
    all_files: int
    report: Callable[[float], None] | None

    def __post_init__(self) -> None:
        self.size, self.taken = self.total, 0

    def update(self, count: int) -> None:
        """Count bytes that have arrived."""
        self.taken += count
        # pooch counts the last chunk as a whole one.
        if self.taken >= self.size + _CHUNK:
            raise _TooLongError
        if self.report:
            self.report((self.before + min(self.taken, self.size)) / self.all_files)

    def reset(self) -> None:
        """Start the file anew."""
        self.taken = 0

    def close(self) -> None:
        """Do nothing: there is no bar to close."""


def _fetch_one(store: Any, dataset: Dataset, file: DatasetFile, meter: _Meter) -> None:
    download = pooch.HTTPDownloader(progressbar=meter, chunk_size=_CHUNK, timeout=_TIMEOUT)

    def attempt(url: str, target: str, pooch_store: Any) -> None:
        meter.reset()
        download(url, target, pooch_store)

    try:
        # Not by pooch, which fails where another process makes the same folder meanwhile.
        (store.abspath / file.name).parent.mkdir(parents=True, exist_ok=True)
        store.fetch(file.name, downloader=attempt)
        return
    except _TooLongError:
        too_long = f"is longer than the {file.size} bytes that are known"
        fault = f"{too_long}; it is not the file that was published"
    except requests.RequestException as error:
        fault = (
            f"cannot be fetched ({type(error).__name__}); check the network, "
            f"or copy the data set yourself and set {DATA_VARIABLE}"
        )
    except ValueError:
        # pooch's word for a wrong hash; it has removed the file.
        fault = (
            f"its SHA-256 is not {file.sha256[:16]}...; it is not the file "
            "that was published: try again later"
        )
    except OSError as error:
        raise RecordingError(f"{file.name}: cannot be written to the cache ({error})") from None
    raise RecordingError(f"{dataset.url(file)}: {fault}")
