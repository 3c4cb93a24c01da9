"""Tests of truejoint.export.export_ros; tests/test_lab_day.py builds and runs a package."""

import re
import subprocess
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from tests.synthetic import build_recording

import truejoint
from truejoint.errors import ExportError
from truejoint.export import export_ros

from .library import COMPILER, CPP, needs_compiler

MAIN = """
#include <fstream>
#include <iostream>
#include "left_joints.hpp"
struct State { std::vector<std::string> name; std::vector<double> position, velocity, effort; };
int main() {
  std::ifstream rows("rows.txt");
  JointCorrector corrector;
  corrector.SetHoming(true);
  double t;
  State in, out;
  std::vector<double> width;
  in.position.resize(7), in.velocity.resize(7), in.effort.resize(7);
  while (rows >> t) {
    for (double& q : in.position) rows >> q;
    for (double& e : in.effort) rows >> e;
    corrector.Correct(in, t, &out, &width);
    std::cout << corrector.Unlearnt() << std::endl;
  }
  in.name = {"gold_shoulder", "elbow"};
  const int good = corrector.Correct(in, 1e3, &out, &width);
  in.name = {"elbow", "shoulder"};
  std::cout << (good < 0) << corrector.Correct(in, 1e3, &out, &width) << std::endl;
}
"""


def test_each_signal_is_taken_from_its_place_in_a_joint_state(tmp_path):
    features = ["measured/elbow", "effort/jaw2", "measured/unused"]
    model = truejoint.calibrate(build_recording(400), "linear", features=features)
    paths = export_ros(model, tmp_path, prefix="left")
    assert {path.name for path in paths} >= {"package.xml", "CMakeLists.txt", "left_ros1.cpp"}
    text = (tmp_path / "left_joints.hpp").read_text()
    taken = re.findall(r"static_cast<double>\((.*)\),  // (\S+)", text)
    wanted = {"measured/elbow": "in.position[1]", "effort/jaw2": "motor[6]",
              "measured/unused": "0.0"}  # fmt: skip
    assert {name: value for value, name in taken if name in wanted} == wanted
    assert "setpoint_js" not in (tmp_path / "left_ros1.cpp").read_text()
    for name, ns, reads in (
        ("correct.launch", "ns", "arg"),
        ("correct.launch.xml", "namespace", "var"),
    ):
        node = ET.fromstring((tmp_path / name).read_text()).find("node")  # noqa: S314 - our own
        assert (node.get("pkg"), node.get(ns)) == ("left_corrector", f"$({reads} ns)")
    paths[0].unlink()
    with pytest.raises(ExportError, match="exists"):
        export_ros(model, tmp_path, prefix="left")
    assert not paths[0].exists()  # all of a package or nothing


@needs_compiler
@pytest.mark.skipif(CPP is None, reason="no C++ compiler on this machine")
def test_a_package_says_how_the_motion_is_unlike_the_trainings_and_reads_names(tmp_path):
    recording = build_recording(900)
    model = truejoint.calibrate(recording, "linear", features=["measured/elbow", "effort/elbow"])
    export_ros(model, tmp_path, prefix="left")
    robot = recording.robot
    rows = np.column_stack([recording.columns("measured", robot.joint_names),
                            robot.transmission.joint_effort(
                                recording.columns("effort", robot.joint_names))])  # fmt: skip
    np.savetxt(tmp_path / "rows.txt", np.c_[3.0 * recording.t, rows])
    (tmp_path / "main.cpp").write_text(MAIN)
    for compiler, source in ((COMPILER, "left.c"), (CPP, "main.cpp")):
        command = [compiler, "-O1", "-c", source]
        subprocess.run(command, check=True, cwd=tmp_path)  # noqa: S603  # our own
    link = [CPP, "main.o", "left.o", "-lm", "-o", "run"]
    subprocess.run(link, check=True, cwd=tmp_path)  # noqa: S603  # our own
    said = subprocess.check_output([tmp_path / "run"], text=True, cwd=tmp_path).splitlines()  # noqa: S603  # our own
    assert said[0] == ""
    assert "the arm moves slower than in training" in said[-2]
    assert said[-1] == "0-1"
    assert "if (!unlearnt.empty())" in (tmp_path / "left_ros1.cpp").read_text()


def test_a_model_of_what_no_joint_state_has_is_refused(tmp_path):
    recording = build_recording(400)
    columns = {"motor/elbow": recording.column("measured/elbow") * 121.0}
    with_motor = truejoint.Recording.from_columns(
        {**dict(recording.table), **columns}, recording.provenance,
        {**recording.units, "motor/elbow": "rad"},
    )  # fmt: skip
    model = truejoint.calibrate(with_motor, "linear", features=["motor/elbow"])
    with pytest.raises(ExportError, match="no joint state has motor/elbow"):
        export_ros(model, tmp_path)
