"""Fetching from a server on this machine, and finding copies; no network is needed."""

import gzip
import hashlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from tests.recordings.refusals import refused

from truejoint.recordings.datasets import (
    DATASETS,
    Dataset,
    DatasetFile,
    catalogue,
    fetch,
    locate,
    read_dataset,
    store,
)

NAME = "kflex_tendon_sheath"


@dataclass
class Upstream:
    """A repository's files, and the paths that were asked for."""

    folder: Path
    asked: list[str] = field(default_factory=list)


def kflex_text(scale: float) -> bytes:
    t = np.arange(40) * 0.025
    rows = np.column_stack([t, scale * np.sin(t), *[np.zeros(40)] * 6])
    return "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows).encode() + b"\n"


@pytest.fixture
def dataset(monkeypatch: pytest.MonkeyPatch) -> Dataset:
    """A data set of two small files in place of a real one."""
    recordings = {}
    for name, scale in (("a", 10.0), ("b", 20.0)):
        data = kflex_text(scale)
        file = DatasetFile(
            f"{name}.txt", f"some where/{name}.txt", len(data), hashlib.sha256(data).hexdigest()
        )
        recordings[name] = (file,)
    layout = {**DATASETS[NAME].layouts[0], "files": "*"}
    small = replace(DATASETS[NAME], recordings=recordings, layouts=[layout])
    monkeypatch.setattr(catalogue, "DATASETS", {NAME: small})
    return small


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setattr(store, "cache_folder", lambda: folder)
    monkeypatch.setenv("TRUEJOINT_DATA", "")
    # Nothing beside the project is to be found.
    monkeypatch.setattr(store, "__file__", str(tmp_path / "a/b/c/d/e/store.py"))
    return folder


@pytest.fixture
def upstream(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Upstream]:
    result = Upstream(tmp_path / "upstream")
    for (file,), scale in zip(dataset.recordings.values(), (10.0, 20.0), strict=True):
        path = result.folder / dataset.repository / dataset.commit / file.upstream
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(kflex_text(scale))

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            result.asked.append(self.path)

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(result.folder)))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(catalogue, "RAW_HOST", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setattr(store, "_RETRIES", 0)
    yield result
    server.shutdown()
    server.server_close()
    thread.join()


def served(upstream: Upstream, name: str) -> Path:
    return next(upstream.folder.rglob(f"{name}.txt"))


def test_fetches_checks_and_opens(upstream, cache):
    done: list[float] = []
    folder = fetch(NAME, progress=done.append)
    assert folder == cache / NAME == locate(NAME)
    assert (folder / "a.txt").read_bytes() == kflex_text(10.0)
    assert max(done) == done[-1] == 1.0
    assert 0.0 < min(done) <= 0.5
    assert all("some%20where" in path for path in upstream.asked)
    done.clear()
    recordings = read_dataset(NAME, progress=done.append)
    assert done == [0.5, 1.0]
    assert [r.provenance.session for r in recordings] == ["a", "b"]
    assert recordings[1].provenance.source == (
        "nhoyh/hysteresis_compensation_ROS@7c00843f:some where/b.txt"
    )
    assert [len(r) for r in read_dataset(NAME, "b")] == [40]


def test_what_is_there_is_not_fetched_again(upstream, cache):
    fetch(NAME, "a")
    assert len(upstream.asked) == 1
    assert not (cache / NAME / "b.txt").exists()
    fetch(NAME)
    assert len(upstream.asked) == 2
    (cache / NAME / "a.txt").write_bytes(b"spoiled")
    fetch(NAME)
    assert len(upstream.asked) == 3
    assert (cache / NAME / "a.txt").read_bytes() == kflex_text(10.0)


def test_two_that_fetch_at_once_make_the_same_folders(upstream, cache, monkeypatch):
    """Just before a folder is made, the other has made it."""
    small = catalogue.DATASETS[NAME]
    deep = {
        name: (replace(file, name=f"in/{file.name}"),) for name, (file,) in small.recordings.items()
    }
    monkeypatch.setattr(catalogue, "DATASETS", {NAME: replace(small, recordings=deep)})
    make = os.makedirs

    def made(path: str, *more: object, **how: object) -> None:
        Path(path).mkdir(parents=True, exist_ok=True)
        make(path, *more, **how)

    monkeypatch.setattr(os, "makedirs", made)
    fetch(NAME)
    assert (cache / NAME / "in" / "b.txt").read_bytes() == kflex_text(20.0)


@pytest.mark.parametrize(
    "content",
    [kflex_text(11.0)[: len(kflex_text(10.0))], kflex_text(10.0)[:-5], kflex_text(10.0) * 2],
)
def test_another_file_is_never_put_in_place(upstream, cache, content):
    served(upstream, "b").write_bytes(content)
    refused("is not the file that was published", fetch, NAME)
    assert sorted(p.name for p in (cache / NAME).iterdir()) == ["a.txt"]


def test_a_file_that_is_gone_upstream(upstream, cache):
    served(upstream, "a").unlink()
    refused(r"cannot be fetched \(HTTPError\).*TRUEJOINT_DATA", fetch, NAME)


def test_no_network(dataset, cache, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(store, "_RETRIES", 0)
    # Nobody listens on port 9 of this machine.
    monkeypatch.setattr(catalogue, "RAW_HOST", "http://127.0.0.1:9")
    refused(r"cannot be fetched \(ConnectionError\)", fetch, NAME)
    refused(f"no copy .* run 'truejoint datasets {NAME} --fetch'", locate, NAME)


def test_a_folder_of_copies_comes_first(dataset, cache, tmp_path, monkeypatch):
    copies = tmp_path / "copies"
    (copies / NAME).mkdir(parents=True)
    (cache / NAME).mkdir(parents=True)
    (cache / NAME / "a.txt").touch()
    monkeypatch.setenv("TRUEJOINT_DATA", str(copies))
    assert locate(NAME) == cache / NAME
    # Copies may be in gzip: the hash is that of what is inside.
    (copies / NAME / "a.txt.gz").write_bytes(gzip.compress(kflex_text(10.0)))
    assert locate(NAME) == copies / NAME
    assert len(read_dataset(NAME, "a")) == 1
    refused(r"b.txt: is missing", read_dataset, NAME)
    (copies / NAME / "b.txt").write_bytes(kflex_text(10.0))
    refused(r"b.txt: is not the file of nhoyh/.*SHA-256 differs", read_dataset, NAME)


def test_a_variable_that_names_no_folder(cache, monkeypatch):
    monkeypatch.setenv("TRUEJOINT_DATA", "/nowhere/at/all")
    refused("TRUEJOINT_DATA=/nowhere/at/all: is not a folder", locate, NAME)


@pytest.mark.parametrize("name", list(DATASETS))
def test_a_copy_on_this_machine_is_the_upstream_one(name, dataset_folder):
    dataset_folder(name)
    dataset = DATASETS[name]
    last = list(dataset.recordings)[-1]
    recordings = read_dataset(name, last)
    assert len(recordings) == 1
    assert recordings[0].robot.name == dataset.robot
    signals = {feature.split("(")[-1].split(",")[0] for feature in dataset.features}
    assert bool(recordings[0].joints_of("truth")) == bool(dataset.splits)
    assert signals <= set(recordings[0].table.columns)
