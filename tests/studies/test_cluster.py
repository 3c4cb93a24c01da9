"""Studies on a real Dask scheduler with real workers, on this computer."""

import os
import re
import socket
import subprocess
import sys
from contextlib import ExitStack
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from truejoint.errors import StudyError
from truejoint.studies import run_study, runner

pytestmark = pytest.mark.skipif(not find_spec("distributed"), reason="Dask is not installed")


def scheduler(**how):
    """Scheduler and workers that nobody else can reach."""
    import distributed  # noqa: PLC0415  # half a second, where no test here runs

    return distributed.LocalCluster(
        host="127.0.0.1",
        protocol="tcp://",
        dashboard_address=":0",
        threads_per_worker=how.pop("threads", 1),
        **how,
    )


def test_a_worker_that_is_killed_costs_its_part(toy, tmp_path, monkeypatch):
    paths = [str(toy.log.parent / "module"), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    alone = run_study(toy.study)
    assert toy.computed == [0, 1, 2, 3]
    toy.trouble("die-once@1")
    with scheduler(n_workers=2, processes=True) as made:
        there = run_study(toy.study, folder=tmp_path, cluster=made.scheduler_address)
        assert Path(f"{toy.log}.died").exists()
        assert set(toy.computed) == {0, 1, 2, 3}  # what a killed worker still had is done again
        others = [pair for pair in runner.versions() if pair[0] != "truejoint"]
        monkeypatch.setattr(runner, "versions", lambda: [("truejoint", "0.0.9"), *others])
        runner.software.cache_clear()
        own = re.escape(version("truejoint"))
        with pytest.raises(
            StudyError, match=rf"a worker on \S+ has other software: truejoint {own}"
        ):
            run_study(toy.study, cluster=made.scheduler_address)
        runner.software.cache_clear()
    assert there.to_dict() == alone.to_dict()  # bit for bit
    for key, part in alone.parts.items():
        assert np.array_equal(part.arrays["values"], there.parts[key].arrays["values"])
    # All parts are kept: no scheduler is needed any more.
    assert run_study(toy.study, folder=tmp_path, cluster="tcp://127.0.0.1:9").computed == 0


@pytest.mark.parametrize(
    ("workers", "patience", "says"),
    [(1, 20.0, "has 2 threads; start it with --nthreads 1"), (0, 0.5, "has no workers")],
)
def test_workers_of_several_threads_or_none_are_refused(toy, monkeypatch, workers, patience, says):
    monkeypatch.setattr(runner, "_PATIENCE", patience)
    with scheduler(n_workers=workers, processes=False, threads=2) as made:
        address = made.scheduler_address
        with pytest.raises(StudyError, match=says):
            run_study(toy.study, cluster=address)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere", "gopher://127.0.0.1:9", ""])
def test_a_scheduler_that_cannot_be_reached_is_one_line(toy, monkeypatch, address):
    monkeypatch.setattr(runner, "_ANSWER", 0.2)
    with pytest.raises(StudyError, match="no scheduler at") as refused:
        run_study(toy.study, cluster=address)
    assert "\n" not in str(refused.value)


KILLS = """
import os, signal, sys
from functools import partial
from truejoint.studies import runner

runner._ANSWER = runner._PATIENCE = 120.0
try:
    list(runner.on_cluster(partial(os.kill, int(sys.argv[1])), [signal.SIGKILL], sys.argv[2]))
except runner.StudyError as error:
    sys.exit(str(error))
"""


def test_a_scheduler_that_dies_is_one_line():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    dask, bare = [sys.executable, "-m"], "--no-dashboard"
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, bare]
    worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", bare]
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(subprocess.Popen([*dask, *line], stderr=subprocess.DEVNULL))  # noqa: S603
            for line in (scheduler, worker)
        )
        stack.callback(second.kill)
        stack.callback(first.kill)
        kills = [sys.executable, "-c", KILLS, str(first.pid), address]
        said = subprocess.run(kills, capture_output=True, text=True, check=False)  # noqa: S603
    lost = f"the scheduler at {address} was lost; what is done is kept: run it again\n"
    assert (said.stdout, said.stderr) == ("", lost)
