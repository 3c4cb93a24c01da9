"""A study of four parts that can be told to go wrong, in a module that other processes find."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from truejoint.studies import Option, Study, StudyResult, runner, write_study

MODULE = """
import os
import signal

import numpy as np

from truejoint.errors import TruejointError
from truejoint.studies import Claim, Part, PartResult, Summary
from truejoint.drawing import Curve, Figure, Panel
from truejoint.tables import Table


def parts(settings):
    common = {"seed": settings.seed, "scale": settings["scale"]}
    return [Part(f"part-{n}", compute, {"n": n, **common}) for n in range(settings["count"])]


def compute(n, seed, scale):
    trouble, _, where = os.environ.get("TOY_TROUBLE", "").partition("@")
    if trouble and int(where) == n:
        if trouble == "refuse":
            raise TruejointError("the plant is out of order")
        if trouble == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if trouble == "orphan":
            os.kill(os.getppid(), signal.SIGKILL)
            signal.pause()
        if trouble == "die-once" and not os.path.exists(os.environ["TOY_LOG"] + ".died"):
            open(os.environ["TOY_LOG"] + ".died", "w").close()
            os._exit(1)
    with open(os.environ["TOY_LOG"], "a") as log:
        log.write(f"{n}\\n")
    values = np.random.default_rng([seed, n]).normal(0.0, scale, 50)
    return PartResult([{"n": n, "mean_value": float(values.mean())}], {"values": values})


def summarise(results):
    rows = tuple((row.part, f"{row.mean_value:.17g}") for row in results.rows.itertuples())
    curves = [Curve(range(50), own["values"], key) for key, own in results.arrays.items()]
    table = Table("Means [1] <b>", ("part", "mean [/x]"), rows, ("a | note",))
    figure = Figure("Toy", ((Panel(curves, "row", "value", log="x", legend=True),),), "What it is.")
    claims = [Claim("means differ", "toy2020", holds, "so") for holds in (True, False, None)]
    claims.append(Claim("means differ", "toy2020", False, "better", flaw=True))
    return Summary((table,), {"toy": figure}, claims)
"""


@dataclass(frozen=True)
class Toy:
    """The study, and what was computed of it."""

    study: Study
    log: Path
    trouble: Callable[[str], None]

    @property
    def computed(self) -> list[int]:
        """Numbers of the parts that were computed since last asked, in order."""
        lines = self.log.read_text().split() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return [int(line) for line in lines]


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Toy:
    """A study whose module is `toy_study`; `trouble("kind@part")` makes a part go wrong."""
    folder = tmp_path / "module"
    folder.mkdir()
    (folder / "toy_study.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("TOY_LOG", str(tmp_path / "log"))
    options = (Option("count", 4, "parts", small=2), Option("scale", 1.0, "size"))
    study = Study("toy", "A toy & its <parts>", "toy2020", "toy_study", options)
    runner._digest_of.cache_clear()
    runner._workers.cache_clear()  # which know another test's environment
    return Toy(study, tmp_path / "log", lambda text: monkeypatch.setenv("TOY_TROUBLE", text))


@pytest.fixture
def coarse(coarse: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures without ticks and labels of axes, too, which take longer than all else in them."""
    for method in ("draw", "get_tightbbox"):
        monkeypatch.setattr(f"matplotlib.axis.Axis.{method}", lambda *_, **__: None)


@pytest.fixture
def drawn(tmp_path: Path, coarse: None) -> Callable[[StudyResult], bool]:
    """Whether every figure of a study can be drawn."""

    def draw(result: StudyResult) -> bool:
        pictures = [file for file in write_study(result, tmp_path) if file.suffix == ".png"]
        return bool(pictures) and all(
            file.read_bytes().startswith(b"\x89PNG\r\n") for file in pictures
        )

    return draw
