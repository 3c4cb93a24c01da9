"""Where the public data sets are on this machine, and how they get there."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
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
    report = progress or (lambda _: None)
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        for file in wanted:
            before = done
            _fetch_one(store, dataset, file, lambda taken: report((before + taken) / total))  # noqa: B023
            done += file.size
            report(done / total)
    finally:
        logger.setLevel(level)
        # `locate` would take a folder without a file for a copy.
        for inner, _, _ in os.walk(folder, topdown=False):
            with suppress(OSError):  # not empty, or another process has been quicker
                Path(inner).rmdir()
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
        paths = [_require_upstream(dataset, folder, file) for file in recording.files]
        alone = len(paths) == 1
        column_map = dataset.maps.get(recording.name)
        options = {"column_map": column_map} if column_map else {}
        place = paths[0] if alone else paths[0].parent
        result = read_recording(place, dataset.format or None, session=recording.name, **options)
        repository, commit, upstream = dataset.origin(recording.files[0])
        path = upstream if alone else PurePosixPath(upstream).parent
        source = f"{repository}@{commit[:8]}:{path}"
        recordings.append(replace(result, provenance=replace(result.provenance, source=source)))
        if progress:
            progress(len(recordings) / len(wanted))
    return recordings


def _require_upstream(dataset: Dataset, folder: Path, file: DatasetFile) -> Path:
    """Copy of a file, plain or in gzip; raises RecordingError if it is not the upstream one."""
    plain = folder / file.name
    path = plain if plain.is_file() else folder / f"{file.name}.gz"
    if not path.is_file():
        raise RecordingError(f"{plain}: is missing; run 'truejoint datasets fetch {dataset.name}'")
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
                    raise OverflowError  # which pooch does not try again
                report(taken)

    try:
        # Not by pooch, which fails where another process makes the same folder meanwhile.
        (store.abspath / file.name).parent.mkdir(parents=True, exist_ok=True)
        store.fetch(file.name, downloader=download)
    except OverflowError:
        raise RecordingError(
            f"{dataset.url(file)}: is longer than the {file.size} bytes that are known; it is not "
            "the file that was published"
        ) from None
    except requests.RequestException as error:
        raise RecordingError(
            f"{dataset.url(file)}: cannot be fetched ({type(error).__name__}); check the network, "
            f"or copy the data set yourself and set {DATA_VARIABLE}"
        ) from None
    except ValueError:  # pooch's word for a wrong hash; it has removed the file
        raise RecordingError(
            f"{dataset.url(file)}: its SHA-256 is not {file.sha256[:16]}...; it is not the file "
            "that was published: try again later"
        ) from None
    except OSError as error:
        raise RecordingError(f"{file.name}: cannot be written to the cache ({error})") from None
