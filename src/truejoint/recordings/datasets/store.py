"""Where the public data sets are on this machine, and how they get there."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

import pooch
import requests

from truejoint.errors import RecordingError
from truejoint.recordings.datasets.catalogue import (
    Dataset,
    DatasetFile,
    DatasetRecording,
    get_dataset,
)
from truejoint.recordings.files import sha256_of
from truejoint.recordings.formats import read_recording
from truejoint.recordings.recording import Recording

DATA_VARIABLE: Final = "TRUEJOINT_DATA"
"""Environment variable: a folder with one folder per data set, files as upstream or in gzip."""

_TIMEOUT: Final = 30.0
_ATTEMPTS: Final = 2
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
    folders = []
    stated = os.environ.get(DATA_VARIABLE, "")
    if stated:
        if not Path(stated).is_dir():
            raise RecordingError(f"{DATA_VARIABLE}={stated}: is not a folder; correct or unset it")
        folders.append(Path(stated))
    project = Path(__file__).parents[4]
    beside = project.parent / "shared" / "data"
    if not stated and (project / "pyproject.toml").is_file() and beside.is_dir():
        folders.append(beside)
    return (*folders, cache_folder())


def locate(name: str) -> Path:
    """Folder of a data set on this machine.

    Parameters
    ----------
    name : str
        One of `DATASETS`.

    Returns
    -------
    Path
        The first of `data_folders` that has it, whole or in part.

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
    """Get a data set, or part of it, from its upstream repository into the user's cache.

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

    Returns
    -------
    Path
        Folder of the data set in the cache.

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
        retry_if_failed=_ATTEMPTS - 1,
    )
    total = sum(file.size for file in wanted)
    done = 0
    report = progress or _ignore
    with _quiet_pooch():
        for file in wanted:
            _fetch_one(store, dataset, file, _Meter(file.size, done, total, report))
            done += file.size
            report(done / total)
    return folder


def open_dataset(
    name: str, pattern: str = "*", *, progress: Callable[[float], None] | None = None
) -> list[Recording]:
    """Read recordings of a data set that is on this machine.

    Parameters
    ----------
    name : str
        One of `DATASETS`.
    pattern : str
        Shell pattern of the recordings' names, for instance ``"Tool_4_Maryland_L_4/3?"``.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Returns
    -------
    list of Recording
        In the order of the catalogue; the session of each is its name in the data set, its source
        the upstream place.

    Raises
    ------
    RecordingError
        If there is no copy here, a file is missing or is not the one that is known upstream.

    Examples
    --------
    >>> open_dataset("davinci_grasper_umn", "*_500*")  # doctest: +SKIP
    """
    dataset = get_dataset(name)
    wanted = dataset.match(pattern)
    folder = locate(name)
    report = progress or _ignore
    opened = []
    for count, recording in enumerate(wanted, start=1):
        opened.append(_open_one(dataset, folder, recording))
        report(count / len(wanted))
    return opened


def _open_one(dataset: Dataset, folder: Path, recording: DatasetRecording) -> Recording:
    paths = [_existing(dataset, folder, file) for file in recording.files]
    for file, path in zip(recording.files, paths, strict=True):
        if sha256_of(path) != file.sha256:
            raise RecordingError(
                f"{path}: is not the file of {dataset.repository} at {dataset.commit[:8]} "
                "(its SHA-256 differs); fetch it again"
            )
    path = paths[0] if len(paths) == 1 else paths[0].parent
    result = read_recording(path, dataset.format, session=recording.name)
    upstream = PurePosixPath(recording.files[0].upstream)
    upstream = upstream if len(paths) == 1 else upstream.parent
    source = f"{dataset.repository}@{dataset.commit[:8]}:{upstream}"
    return replace(result, provenance=replace(result.provenance, source=source))


def _existing(dataset: Dataset, folder: Path, file: DatasetFile) -> Path:
    for path in (folder / file.name, folder / f"{file.name}.gz"):
        if path.is_file():
            return path
    raise RecordingError(
        f"{folder / file.name}: is missing; run 'truejoint datasets fetch {dataset.name}'"
    )


class _TooLongError(Exception):
    """More bytes arrive than the file has."""


class _Meter:
    """What pooch tells of its progress on one file, as part of all files."""

    def __init__(
        self, size: int, before: int, all_files: int, report: Callable[[float], None]
    ) -> None:
        self._size = size
        self._before = before
        self._all = all_files
        self._report = report
        self._taken = 0
        # pooch sets it to what the server says; the size in the catalogue is what counts.
        self.total = size

    def update(self, count: int) -> None:
        """Count bytes that have arrived."""
        self._taken += count
        # pooch counts the last chunk as a whole one.
        if self._taken >= self._size + _CHUNK:
            raise _TooLongError
        self._report((self._before + min(self._taken, self._size)) / self._all)

    def reset(self) -> None:
        """Start the file anew."""
        self._taken = 0

    def close(self) -> None:
        """Do nothing: there is no bar to close."""


def _fetch_one(store: Any, dataset: Dataset, file: DatasetFile, meter: _Meter) -> None:
    download = pooch.HTTPDownloader(progressbar=meter, chunk_size=_CHUNK, timeout=_TIMEOUT)

    def attempt(url: str, target: str, pooch_store: Any) -> None:
        meter.reset()
        download(url, target, pooch_store)

    try:
        store.fetch(file.name, downloader=attempt)
    except _TooLongError:
        raise RecordingError(
            f"{dataset.url(file)}: is longer than the {file.size} bytes that are known; it is not "
            "the file that was published"
        ) from None
    except requests.RequestException as error:
        raise RecordingError(
            f"{dataset.url(file)}: cannot be fetched ({type(error).__name__}); check the network, "
            f"or copy the data set yourself and set {DATA_VARIABLE}"
        ) from None
    except ValueError:
        # pooch's word for a wrong hash; it has removed the file.
        raise RecordingError(
            f"{dataset.url(file)}: its SHA-256 is not {file.sha256[:16]}...; it is not the file "
            "that was published: try again later"
        ) from None
    except OSError as error:
        raise RecordingError(f"{file.name}: cannot be written to the cache ({error})") from None


@contextmanager
def _quiet_pooch() -> Iterator[None]:
    logger = pooch.get_logger()
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _ignore(_fraction: float) -> None:
    """Progress that nobody watches."""
