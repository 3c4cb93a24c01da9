"""Draw the manual's pictures, each of what its page says.

Run ``python docs/pictures/manual.py [NAME ...]``; it needs the extra ``plots`` and two minutes.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import truejoint
from truejoint.cli import demo
from truejoint.motion import designed_motion, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Stream
from truejoint.recordings.join.joining import find_clock_offset
from truejoint.runtime import Compensator, Corrector, OnFault, motor_loop
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps.methods import record
from truejoint.tables import DASH

MEASURED, TRUE, OTHER, CORRECTED = "#b3541e", "#1a1a1a", "#8a8a8a", "#1f6fb2"
WIDTH: Final = 8.0  # [in]
PAGES: Final = Path(__file__).parents[1]
ELBOW: Final = "elbow"


@cache
def twin() -> truejoint.crtk.Arm:
    """Give a simulated RAVEN-II, enabled and homed."""
    of_paper = truejoint.simulation.make_twin("raven2", "left", parameters="peng2024", seed=0)
    arm = truejoint.crtk.Arm(truejoint.crtk.SimulatedBackend(of_paper))
    arm.enable()
    arm.home()
    return arm


def recorded(motion: truejoint.motion.Trajectory, **how: Any) -> truejoint.Recording:
    """Follow a motion and keep what the twin's arm reports, with the truth."""
    with Recorder(twin(), state_rate=30.0) as recorder:
        follow(twin(), motion, **how)
    return recorder.recording()


@cache
def training() -> list[truejoint.Recording]:
    """Record the motions that the models are made of."""
    return [recorded(random_motion(twin().robot, 240.0, seed=k)) for k in range(3)]


def panels(rows: int = 1, columns: int = 1, height: float = 2.8, **how: Any) -> Any:
    """Give a figure and its axes, in the manual's manner."""
    figure, axes = plt.subplots(
        rows, columns, figsize=(WIDTH, height), layout="constrained", squeeze=False, **how
    )
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def doubt() -> Any:
    """Draw what the corrected position does while an effort is missing for four seconds."""
    corrector_of = {
        name: Corrector(truejoint.calibrate(training(), "linear"), on_fault=OnFault(name))
        for name in ("hold", "raw")
    }
    test = recorded(random_motion(twin().robot, 14.0, seed=4))
    t = test.t - test.t[0]
    gone = (t > 5.0) & (t < 9.0)
    figure, axes = panels()
    axis = axes[0, 0]
    for (name, corrector), colour in zip(corrector_of.items(), (CORRECTED, OTHER), strict=True):
        corrector.set_homing(True, twin().homing_id)
        samples = test.table[list(corrector.signals)].to_numpy(copy=True)
        samples[gone, list(corrector.signals).index(f"effort/{ELBOW}")] = np.nan
        joint = list(corrector.joints).index(ELBOW)
        correction = []
        for stamp, sample in zip(test.t, samples, strict=True):
            corrector.step(stamp, sample)
            measured = sample[list(corrector.signals).index(f"measured/{ELBOW}")]
            correction.append(corrector.position[joint] - measured)
        axis.plot(t, np.degrees(correction), color=colour, lw=1.6, label=f'on_fault="{name}"')
    truth = test.column(f"truth/{ELBOW}") - test.column(f"measured/{ELBOW}")
    axis.plot(t, np.degrees(truth), color=TRUE, lw=1.0, ls=":", label="true")
    axis.axvspan(5.0, 9.0, color="#f3e6dc", zorder=0)
    axis.text(7.0, -0.8, "no effort", ha="center", color=MEASURED)
    axis.set(xlabel="time [s]", ylabel="correction of the elbow [deg]")
    axis.legend(frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0))
    return figure


def late_or_loop() -> Any:
    """Draw truth against measured for a late clock and for a loop, at two speeds."""
    figure, axes = panels(1, 2, 3.2, sharey=True)
    for axis, title in zip(axes[0], ("clock 0.1 s late", "hysteresis of 2 deg"), strict=True):
        for period, colour in ((8.0, CORRECTED), (3.0, MEASURED)):
            t = np.arange(0.0, 2.0 * period, 0.01)
            measured = 10.0 * np.sin(2.0 * np.pi * t / period)
            if title.startswith("clock"):
                truth = 10.0 * np.sin(2.0 * np.pi * (t - 0.1) / period)
            else:
                truth = np.empty_like(measured)
                truth[0] = measured[0]
                for k in range(1, len(t)):
                    truth[k] = np.clip(truth[k - 1], measured[k] - 1.0, measured[k] + 1.0)
            last = t >= period
            axis.plot(measured[last], truth[last] - measured[last], color=colour, lw=1.6,
                      label=f"one swing in {period:g} s")  # fmt: skip
        axis.set(title=title, xlabel="measured [deg]")
    axes[0, 0].set_ylabel("truth - measured [deg]")
    axes[0, 1].legend(frameon=False, loc="center", bbox_to_anchor=(0.5, 0.85))
    return figure


def history() -> Any:
    """Draw what a line, a parabola and plays leave of a jaw's error, against its position."""
    motions = (record(specimen("A"), name) for name in ("nested", "cycle"))
    made_of, test = motions
    measured, truth = (
        np.degrees(test.column(f"{name}/jaw"))[::10] for name in ("measured", "truth")
    )
    figure, axes = panels(1, 3, 3.0, sharey=True)
    for axis, name in zip(axes[0], ("linear", "poly2", "rich_play"), strict=True):
        model = truejoint.calibrate(made_of, name, features=("measured/jaw",))
        error = np.degrees(model.correct(test)[::10, 0]) - truth
        axis.plot(measured, error, color=CORRECTED, lw=0.8)
        axis.axhline(0.0, color=TRUE, lw=0.8, ls=":")
        axis.set(title=f"{name}: {np.sqrt(np.nanmean(error**2)):.2f} deg", xlabel="measured [deg]")
    axes[0, 0].set_ylabel("error of the jaw [deg]")
    return figure


def loop() -> Any:
    """Draw a circle of two joints, as it is wanted and as it comes, without and with the loop."""
    arm, joints = twin(), ("shoulder", ELBOW)
    model = truejoint.calibrate(training(), "linear").without_redundant()
    corrector = Corrector(model)
    corrector.set_homing(True, arm.homing_id)
    angle, at = np.linspace(0.0, 2.0 * np.pi, 400), [arm.robot.joint_names.index(j) for j in joints]
    circle = arm.robot.home[at] + math.radians(8.0) * np.c_[np.cos(angle), np.sin(angle)]
    path = truejoint.motion.Trajectory(joints, ("rad", "rad"), circle, 30.0 * angle / angle[-1])
    figure, axes = panels(height=4.2)
    axis = axes[0, 0]
    steerings = {"set-points alone": None, "with Compensator": Compensator(corrector, arm.robot)}
    for (name, steering), colour in zip(steerings.items(), (MEASURED, CORRECTED), strict=True):
        arm.move_jp(arm.robot.home).wait()
        done = recorded(path, steering=steering)
        axis.plot(*np.degrees([done.column(f"truth/{j}") for j in joints])[:, -900:], color=colour,
                  lw=1.6, label=f"joints, {name}")  # fmt: skip
    axis.plot(*np.degrees(circle.T), color=TRUE, lw=1.0, ls=":", label="wanted")
    axis.set(xlabel="shoulder [deg]", ylabel="elbow [deg]", aspect="equal")
    axis.legend(frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


def jaw_under_load() -> Any:
    """Draw a jaw that takes a weight of 100 g: its motor, the paper's filter and gated plays."""
    forceps = specimen("A")
    free = record(forceps, "nested")
    test = record(forceps, LoadTest(0.1, "along"), seed=1)
    t, truth = test.t[::20], np.degrees(test.column("truth/jaw"))[::20]
    figure, axes = panels(2, 1, 4.0, sharex=True)
    measured = np.degrees(test.column("measured/jaw"))[::20]
    axes[0, 0].plot(t, measured, color=MEASURED, lw=1.2, label="measured at the motor")
    axes[0, 0].plot(t, truth, color=TRUE, lw=1.2, label="true")
    names = {"ukf_compensated": "unscented filter, (26)", "play_gated": "gated plays"}
    for (name, title), colour in zip(names.items(), (OTHER, CORRECTED), strict=True):
        error = np.degrees(truejoint.calibrate(free, name).correct(test)[::20, 0]) - truth
        axes[1, 0].plot(t, error, color=colour, lw=1.2, label=title)
    axes[0, 0].set(ylabel="angle [deg]", title="a weight of 100 g is hung on the jaw")
    axes[1, 0].set(xlabel="time [s]", ylabel="error [deg]")
    for axis, place in zip(axes[:, 0], ("lower right", "upper right"), strict=True):
        axis.legend(frameon=False, loc=place, ncols=2)
    return figure


def topics() -> Any:
    """Draw the nodes of a lab's day and the topics between them."""
    figure, axes = panels(height=2.2)
    axis = axes[0, 0]
    axis.set(xlim=(0, 10), ylim=(0.2, 3.8))
    axis.axis("off")
    nodes = {
        "robot,\nor node simulate": (1.3, 2.9), "node encoders": (1.3, 0.8),
        "node correct": (5.2, 2.9), "node record": (5.2, 0.8),
        "your controller": (8.8, 2.9), "calibrate": (8.8, 0.8),
    }  # fmt: skip
    for name, (x, y) in nodes.items():
        axis.text(x, y, name, ha="center", va="center", family="monospace", fontsize=9,
                  bbox={"boxstyle": "round,pad=0.5", "fc": "#eef3f8", "ec": CORRECTED})  # fmt: skip
    arrows = (
        ((2.4, 2.9), (4.4, 2.9), "measured_js\noperating_state"),
        ((6.0, 2.9), (7.8, 2.9), "corrected/measured_js\ncorrected/status"),
        ((2.1, 2.5), (4.5, 1.0), ""),
        ((2.2, 0.8), (4.45, 0.8), "ext_jpos"),
        ((5.95, 0.8), (8.1, 0.8), "recording"),
        ((8.2, 1.1), (5.75, 2.5), "model"),
    )
    for start, end, text in arrows:
        axis.add_patch(
            FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=12, color=OTHER)
        )
        at = np.mean([start, end], axis=0)
        axis.text(at[0], at[1] + (0.3 if text == "model" else 0.08), text, ha="center", va="bottom",
                  fontsize=8, color=TRUE)  # fmt: skip
    return figure


def page_of(name: str) -> dict[str, Any]:
    """Run the first Python block of a page in a new folder; give its variables."""
    text = (PAGES / name).read_text("utf-8")
    block = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    tables = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    names: dict[str, Any] = {}
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        path = Path("page.py").resolve()  # numba keeps what it compiles beside the source
        path.write_text(block, "utf-8")
        Path("lever.toml").write_text(tables[0] if tables else "", "utf-8")
        exec(compile(block, str(path), "exec"), names)  # noqa: S102 - our own page
        files = sorted(Path.cwd().glob("*.csv"))
        names["tables"] = [np.loadtxt(file, delimiter=";", skiprows=1) for file in files]
    return names


def csv() -> Any:
    """Draw the error that the page on CSV files begins with, and what two models leave of it."""
    recordings = []
    for table in page_of("recordings.md")["tables"]:
        t, motor, joint, torque = table.T * [[1e-3], [np.pi / 180], [np.pi / 180], [1e-3]]
        columns = {"t": t, "measured/jaw": motor, "truth/jaw": joint, "effort/jaw": torque}
        recordings.append(truejoint.Recording.from_columns(columns, "davinci_grasper"))
    *made_of, test = recordings
    figure, axes = panels()
    axis = axes[0, 0]
    axis.plot(
        test.t, np.degrees(-test.error(test.joints)), color=MEASURED, lw=1.2, label="reported"
    )
    for name, colour in (("linear", OTHER), ("rich_play", CORRECTED)):
        error = truejoint.calibrate(made_of, name).correct(test)[:, 0] - test["truth/jaw"]
        axis.plot(test.t, np.degrees(error), color=colour, lw=1.2, label=name)
    axis.set(xlabel="time [s]", ylabel="error of the wrist [deg]")
    axis.legend(frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0))
    return figure


def pendulum() -> Any:
    """Draw what the page's filter makes of an encoder that is silent for 50 ms."""
    names = page_of("filter.md")
    result, t = names["result"], names["t"]
    sd = 2.0 * np.sqrt(np.diagonal(result.P, axis1=1, axis2=2))
    figure, axes = panels(1, 2, 2.8)
    for k, (axis, label) in enumerate(zip(axes[0], ("angle [rad]", "rate [rad/s]"), strict=True)):
        axis.fill_between(t, result.x[:, k] - sd[:, k], result.x[:, k] + sd[:, k],
                          color="#c9dcee", label="2 sd")  # fmt: skip
        axis.plot(t, result.x[:, k], color=CORRECTED, lw=1.4, label="filtered")
        axis.axvspan(0.1, 0.15, color="#f3e6dc", zorder=0)
        axis.set(xlabel="time [s]", ylabel=label)
    axes[0, 0].plot(t, names["z"], ".", ms=2, color=MEASURED, label="encoder")
    axes[0, 0].set_ylim(-0.02, 0.12)
    axes[0, 1].set_ylim(-0.5, 0.2)
    axes[0, 0].legend(frameon=False, loc="lower left")
    return figure


def table_1() -> Any:
    """Draw a row of Table I of peng2024 as `truejoint study` computes it, beside the paper's."""
    settings = {"directions": "J2-J3", "fine": "4+5+6"}
    rows = truejoint.studies.run_study("directions", settings, preset="small").rows
    mine = rows.set_index(["joint", "method"])["rmse"]
    file = Path(truejoint.studies.__file__).with_name("paper_tables.csv")
    paper = pd.read_csv(file, index_col=["source", "table", "condition", "quantity", "method"])
    paper = paper.sort_index().loc[("peng2024", "I", "direction=J2-J3")]["value"]
    joints = (("shoulder", "deg"), ("elbow", "deg"), ("insertion", "mm"))
    methods = ("dnn", "poly2", "linear", "offset")
    figure, axes = panels(1, 3, 2.8)
    for k, (axis, (joint, unit)) in enumerate(zip(axes[0], joints, strict=True)):
        scale, x = (1e3 if unit == "mm" else 180.0 / math.pi), np.arange(len(methods))
        twins = [scale * mine[joint, method] for method in methods]
        papers = [paper[f"joint{k + 1}", method] for method in methods]
        axis.bar(x - 0.2, papers, 0.38, color=OTHER, label="paper")
        axis.bar(x + 0.2, twins, 0.38, color=CORRECTED, label="simulated robot")
        axis.set(title=joint, ylabel=f"RMSE [{unit}]", xticks=x, xticklabels=methods)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), frameon=False, loc="outside upper left",
                  ncols=2)  # fmt: skip
    return figure


def rezeroed() -> Any:
    """Draw the elbow's error after the demo's last homing, and after ten seconds of truth."""
    model, arm = truejoint.calibrate(training(), "linear"), twin()
    for _ in range(demo.MAKING + demo.JUDGING + 1):
        arm.home()
    morning = recorded(random_motion(arm.robot, 60.0, seed=9))
    t = morning.t - morning.t[0]
    zero = truejoint.calibration.find_zero(model, morning.rows(t < demo.REZERO))
    figure, axes = panels()
    axis, joint = axes[0, 0], list(model.joints).index(ELBOW)
    for each, colour, label in (
        (model, MEASURED, "as calibrated"),
        (model.at(zero), CORRECTED, "re-zeroed"),
    ):
        error = each.correct(morning)[:, joint] - morning[f"truth/{ELBOW}"]
        axis.plot(t, np.degrees(error), color=colour, lw=1.2, label=label)
    axis.axhline(0.0, color=TRUE, lw=0.8, ls=":")
    axis.axvspan(0.0, 10.0, color="#f3e6dc", zorder=0)
    above = axis.get_xaxis_transform()
    axis.text(5.0, 0.97, "truth", ha="center", va="top", color=MEASURED, transform=above)
    axis.set(xlabel="time [s]", ylabel="error of the elbow [deg]")
    axis.legend(frameon=False, loc="lower left", ncols=2, bbox_to_anchor=(0.0, 1.0))
    return figure


def stored(name: str, title: str = "") -> pd.DataFrame:
    """Read the first table with these words in its title, indexed by its first column."""
    output = json.loads((PAGES / "results" / f"{name}.json").read_text("utf-8"))
    kept = next(table for table in output["tables"] if title in table["title"])
    return pd.DataFrame(kept["rows"], columns=kept["header"]).set_index(kept["header"][0])


def steps_in_c() -> Any:
    """Draw the times of a step in C for three joints, of the table in the results."""
    cells = stored("speed")["3 joints: Python, C"]
    times = {
        name.strip("`"): cell.split(", ")[1]
        for name, cell in cells.items()
        if re.search(r", \d", cell)
    }
    known = sorted(((float(us), name) for name, us in times.items()), reverse=True)
    figure, axes = panels(height=3.2)
    axis = axes[0, 0]
    axis.barh([name for _, name in known], [us for us, _ in known], color=CORRECTED)
    axis.set(xlabel="time of a step in C, three joints [us]")
    return figure


def steps() -> Any:
    """Draw the motions of the first steps: what is calibrated on, and what judges."""
    robot = truejoint.get_robot("raven2", "left")
    motions = {
        "zig-zag, to calibrate on": zigzag(robot, "J1-J2-J3", 0.25),
        "random motion, to judge by": random_motion(robot, 600.0, seed=7),
    }
    figure, axes = panels(1, 2, 3.6, sharey=True)
    for axis, (title, motion) in zip(axes[0], motions.items(), strict=True):
        shoulder, elbow = np.degrees(motion.positions[:, :2].T)
        axis.plot(shoulder, elbow, color=OTHER, lw=0.5, rasterized=True)
        few = slice(None, None, max(1, len(shoulder) // 600))
        insertion = 1e3 * motion.positions[few, 2]
        dots = axis.scatter(shoulder[few], elbow[few], c=insertion, s=8, cmap="viridis", zorder=2)
        axis.set(title=title, xlabel="shoulder [deg]")
    axes[0, 0].set_ylabel("elbow [deg]")
    figure.colorbar(dots, ax=axes[0, 1], label="insertion [mm]")
    return figure


def motions() -> Any:
    """Draw two motions to calibrate on, and the elbow's tracking error with and without a loop."""
    robot = twin().robot
    figure, axes = panels(1, 3, 3.0)
    kinds = {"zig-zag": zigzag(robot, "J1-J2-J3", 0.25), "designed": designed_motion(robot, 150.0)}
    for axis, (title, motion) in zip(axes[0], kinds.items(), strict=False):
        axis.plot(*np.degrees(motion.positions[:, :2].T), color=CORRECTED, lw=0.8)
        axis.set(title=title, xlabel="shoulder [deg]", ylabel="elbow [deg]")
    path, x = random_motion(robot, 60.0, seed=3), np.arange(3)
    steerings = {"set-points alone": None, "with motor_loop": motor_loop(robot)}
    for k, (name, steering) in enumerate(steerings.items()):
        twin().move_jp(robot.home).wait()
        rms = follow(twin(), path, steering=steering).rms * [180 / math.pi, 180 / math.pi, 1e3]
        axes[0, 2].bar(x + 0.4 * k - 0.2, rms, 0.38, color=(MEASURED, CORRECTED)[k], label=name)
    axes[0, 2].set(title="wanted - reported, RMS", ylabel="deg, deg, mm", xticks=x,
                   xticklabels=("shoulder", ELBOW, "insertion"))  # fmt: skip
    axes[0, 2].tick_params(axis="x", labelsize=8)
    axes[0, 2].legend(frameon=False, loc="upper left", fontsize=8)
    axes[0, 2].set_ylim(0.0, 0.5)
    return figure


def clocks() -> Any:
    """Draw two clocks' motions, and how alike they are by the offset that is tried."""
    recording = training()[0]
    joints = ("shoulder", ELBOW, "insertion")
    known = np.isfinite(recording[f"truth/{ELBOW}"])
    t = recording.t[known] - 1.3  # s by which the encoders' clock is behind
    stream = Stream(t, {f"truth/{joint}": recording[f"truth/{joint}"][known] for joint in joints})
    truth = stream.columns[f"truth/{ELBOW}"]
    found = find_clock_offset(recording, stream)
    figure, axes = panels(1, 2, 2.8, width_ratios=(3, 2))
    measured = np.degrees(recording[f"measured/{ELBOW}"])
    for stamps, values, colour, label in (
        (recording.t, measured, MEASURED, "reported by the robot"),
        (t, np.degrees(truth), TRUE, "encoder, by its own clock"),
    ):
        axes[0, 0].plot(stamps - t[0], values - values.mean(), color=colour, lw=1.4, label=label)
    axes[0, 0].set(xlim=(0.0, 30.0), xlabel="time [s]", ylabel="elbow less its mean [deg]")
    axes[0, 0].legend(frameon=False, loc="lower left", ncols=2, bbox_to_anchor=(0.0, 1.0))
    tried = np.arange(-6.0, 6.0, 0.02)
    grid = np.arange(recording.t[0] + 8.0, recording.t[-1] - 8.0, 0.02)
    reported = np.gradient(np.interp(grid, recording.t, measured))
    alike = [
        np.corrcoef(reported, np.gradient(np.interp(grid, t + offset, np.degrees(truth))))[0, 1]
        for offset in tried
    ]
    axes[0, 1].plot(tried, alike, color=CORRECTED, lw=1.4)
    axes[0, 1].axvline(found.seconds, color=TRUE, lw=0.8, ls=":")
    axes[0, 1].set(title=f"{found.seconds:.3f} s found", xlabel="offset that is tried [s]",
                   ylabel="correlation of the speeds")  # fmt: skip
    return figure


def block() -> Any:
    """Draw the printed block, and what six touches of it mend."""
    shape = truejoint.tip.design_block(truejoint.get_robot("raven2", "left"))
    figure = plt.figure(figsize=(WIDTH, 3.4), layout="constrained")
    solid = figure.add_subplot(1, 2, 1, projection="3d")
    facets = np.frombuffer(shape.stl()[84:], np.dtype([("xyz", "<f4", (4, 3)), ("pad", "<u2")]))
    faces = Poly3DCollection(facets["xyz"][:, 1:], facecolors="#dfe8f1", shade=True)
    faces.set_rasterized(True)
    solid.add_collection3d(faces)
    size = 1e3 * shape.size
    solid.set(xlim=(0, size[0]), ylim=(0, size[1]), zlim=(0, size[2]), xlabel="x [mm]",
              ylabel="y [mm]", zlabel="z [mm]", box_aspect=size)  # fmt: skip
    axis = figure.add_subplot(1, 2, 2)
    axis.spines[["top", "right"]].set_visible(False)
    table = stored("touch").reset_index()
    names = [f"{row.specimen}\n{row.model}" for row in table.itertuples()]
    columns = {"after the homing": MEASURED, "after six touches": CORRECTED,
               "full calibration": OTHER}  # fmt: skip
    x = np.arange(len(names))
    for k, (column, colour) in enumerate(columns.items()):
        axis.bar(x + 0.27 * (k - 1), table[column].astype(float), 0.25, color=colour, label=column)
    axis.set(xticks=x, xticklabels=names, ylabel="error of the tip [mm]")
    axis.tick_params(axis="x", labelsize=8)
    axis.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=8)
    return figure


def like() -> Any:
    """Draw what twenty seconds of truth are worth alone, and with models of like instruments."""
    table = stored("like")
    figure, axes = panels(height=2.8)
    axis, x = axes[0, 0], np.arange(len(table))
    columns = ("20 s alone", "20 s like four", "all of its own")
    for k, (column, colour) in enumerate(zip(columns, (MEASURED, CORRECTED, OTHER), strict=True)):
        axis.bar(x + 0.27 * (k - 1), table[column].astype(float), 0.25, color=colour, label=column)
    axis.set(xticks=x, xticklabels=[name.strip("`") for name in table.index], ylabel="RMSE [deg]")
    axis.legend(frameon=False, loc="upper right", ncols=3, bbox_to_anchor=(1.0, 1.2))
    return figure


def psm() -> Any:
    """Draw what a line leaves of two joints' errors on the page of the dVRK's arm."""
    recordings = []
    with truejoint.crtk.simulated_arm("dvrk_psm", "psm1", seed=0) as arm:
        arm.enable()
        arm.home()
        for seconds, seed in ((120.0, 0), (60.0, 5)):
            with Recorder(arm, state_rate=30.0) as recorder:
                follow(arm, random_motion(arm.robot, seconds, seed=seed))
            recordings.append(recorder.recording().with_truth(arm.robot.positioning))
    learn, test = recordings
    joints = ("outer_yaw", "outer_wrist_yaw")
    figure, axes = panels(columns=2, sharex=True)
    for name, colour, label in (
        (None, MEASURED, "reported"),
        ("offset", OTHER, "less a fixed offset"),
        ("linear", CORRECTED, "linear"),
    ):
        error = -test.error(test.joints_of("truth"))
        if name is not None:
            model = truejoint.calibrate(learn, name)
            error = model.correct(test) - test.columns("truth", model.joints)
        for axis, joint in zip(axes[0], joints, strict=True):
            k = test.joints_of("truth").index(joint)
            t = test.t - test.t[0]
            axis.plot(t, np.degrees(error[:, k]), color=colour, lw=1.1, label=label)
            axis.set(xlabel="time [s]", ylabel=f"error of {joint} [deg]")
    axes[0, 0].legend(frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0))
    return figure


def lever() -> Any:
    """Draw the error of the lever that the page on own robots brings, and what its trees leave."""
    names = page_of("robots.md")
    model, test = names["model"], names["test"]
    offset = truejoint.calibrate(names["training"], "offset")
    figure, axes = panels()
    axis = axes[0, 0]
    errors = {
        "reported": -test.error(test.joints)[:, 0],
        "less a fixed offset": offset.correct(test)[:, 0] - test["truth/lever"],
        "trees": model.correct(test)[:, 0] - test["truth/lever"],
    }
    for (name, error), colour in zip(errors.items(), (MEASURED, OTHER, CORRECTED), strict=True):
        axis.plot(test.t[::4], np.degrees(error)[::4], color=colour, lw=1.2, label=name)
    axis.set(xlabel="time [s]", ylabel="error of the lever [deg]")
    axis.legend(frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0))
    return figure


def real() -> Any:
    """Draw what the linear model and the automatic choice leave of the offset's error."""
    table = stored("real")
    table = table[table["offset"] != DASH]
    rows = [name.split(" [")[0] for name in table.index]
    figure, axes = panels(height=5.0)
    axis, y = axes[0, 0], np.arange(len(table))[::-1]
    offset = table["offset"].astype(float)
    for column, colour in (("linear", OTHER), ("dnn", "#d9a05b"), ("auto", CORRECTED)):
        share = 100.0 * table[column].str.split(" ±").str[0].astype(float) / offset
        axis.plot(share, y, "o", color=colour, label=f"-e {column}")
    axis.axvline(100.0, color=TRUE, lw=0.8, ls=":")
    axis.set(yticks=y, yticklabels=rows, xlim=(0.0, None), xlabel="RMSE, % of the fixed offset's")
    axis.tick_params(axis="y", labelsize=8)
    axis.grid(axis="y", color="#e5e5e5", lw=0.6)
    axis.legend(frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0.0, 1.0))
    return figure


def twin_paper() -> Any:
    """Draw the errors of the twin like peng2024 against those that the paper prints."""
    table, pair = (
        stored("directions", "Table I, specimen peng2024"),
        re.compile(r"([\d.]+)[^(]* \(([\d.]+)\)"),
    )
    figure, axes = panels(height=4.0)
    axis = axes[0, 0]
    colours = {"dnn": CORRECTED, "poly2": "#d9a05b", "linear": "#5b8c5a"}
    colours |= {"offset": OTHER, "raw": MEASURED}
    for column in table:
        here = np.array([pair.match(cell).groups() for cell in table[column]], float)
        name = column.split(" ")[0]
        axis.loglog(here[:, 1], here[:, 0], "o", color=colours[name], label=name)
    axis.plot([0.05, 20.0], [0.05, 20.0], color=TRUE, lw=0.8, ls=":")
    axis.set(xlabel="RMSE in the paper [deg, mm]", ylabel="RMSE of the twin [deg, mm]")
    axis.legend(frameon=False, loc="upper left")
    return figure


def interval() -> Any:
    """Draw the elbow's error and interval after another homing, re-zeroed from ten seconds."""
    arm, sessions = twin(), []
    for k in range(20):
        arm.home()
        sessions.append(recorded(random_motion(arm.robot, 40.0, seed=20 + k)))
    linear = truejoint.calibrate(training(), "linear")
    model = truejoint.calibration.with_interval(linear, sessions, rezero=10.0)
    arm.home()
    test = recorded(random_motion(arm.robot, 60.0, seed=50))
    today = model.at(truejoint.calibration.find_zero(model, test.rows(test.t < test.t[0] + 10.0)))
    corrected, lower, upper = today.correct_with_interval(test)
    joint = list(today.joints).index(ELBOW)
    t, truth = test.t - test.t[0], test[f"truth/{ELBOW}"]
    inside = np.mean((lower[:, joint] <= truth) & (truth <= upper[:, joint]))
    figure, axes = panels()
    axis = axes[0, 0]
    bounds = (np.degrees(bound - corrected)[:, joint] for bound in (lower, upper))
    axis.fill_between(t, *bounds, color="#c9dcee", label="90 % interval")
    axis.plot(t, np.degrees(truth - corrected[:, joint]), color=TRUE, lw=1.0,
              label=f"true - corrected, {100.0 * inside:.0f} % inside")  # fmt: skip
    axis.set(xlabel="time [s]", ylabel="elbow [deg]")
    axis.legend(frameon=False, loc="lower left", ncols=2, bbox_to_anchor=(0.0, 1.0))
    return figure


PICTURES: Final[dict[str, Callable[[], Any]]] = {
    "doubt": doubt,
    "history": history,
    "late_or_loop": late_or_loop,
    "jaw_under_load": jaw_under_load,
    "loop": loop,
    "topics": topics,
    "csv": csv,
    "pendulum": pendulum,
    "table_1": table_1,
    "rezeroed": rezeroed,
    "steps_in_c": steps_in_c,
    "steps": steps,
    "motions": motions,
    "clocks": clocks,
    "block": block,
    "like": like,
    "psm": psm,
    "lever": lever,
    "real": real,
    "twin_paper": twin_paper,
    "interval": interval,
}


def main(names: list[str]) -> None:
    """Draw the pictures of these names, all without one, beside this file."""
    mpl.rcParams |= {"svg.hashsalt": "truejoint", "font.size": 10, "svg.fonttype": "none"}
    for name in names or PICTURES:
        path = Path(__file__).with_name(f"{name}.svg")
        twin.cache_clear()  # so that a picture is the same whatever was drawn before
        training.cache_clear()
        PICTURES[name]().savefig(path, metadata={"Date": None}, facecolor="white")
        print(path)  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
