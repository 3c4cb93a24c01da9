"""A URDF with a calibration's offsets errs as with a fixed offset, or one line says why not."""

import json
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from tests.export.test_export_command import run

from truejoint import calibrate, get_robot, write_calibration
from truejoint.crtk import simulated_arm
from truejoint.errors import ExportError
from truejoint.export import export_urdf
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder
from truejoint.robots.urdf import read_urdf

pytest.importorskip("pytransform3d.urdf")


@pytest.fixture(scope="module")
def session():
    """Recording of a PSM's twin, and another one of the same homing."""
    with simulated_arm("dvrk_psm", "psm1", seed=2) as arm:
        arm.enable()
        arm.home()
        runs = []
        for seed in (1, 2):
            with Recorder(arm) as recorder:
                follow(arm, random_motion(arm.robot, 30.0, seed=seed))
            runs.append(recorder.recording().with_truth(arm.robot.positioning))
    return runs


@pytest.fixture(scope="module")
def model(session):
    return calibrate(session[0], "linear")


def document(prefix="PSM1_", extra="", **types):
    """URDF of a PSM, each axis of its table as a fixed joint and a moving one."""
    robot, parts = get_robot("dvrk_psm"), ["<!-- of a PSM -->"]
    for k, (joint, axis) in enumerate(zip(robot.joints[:6], robot.kinematics.axes, strict=False)):
        kind = types.get(joint.name, joint.kind)
        place = f'xyz="{axis.a} 0 0" rpy="{axis.alpha} 0 0"'
        turn = f'xyz="0 0 {axis.d}" rpy="0 0 {axis.theta}"'
        for name, joint_type, origin, inner in (
            (f"fixed_{k}", "fixed", place, ""),
            (f"{prefix}{joint.name}", kind, turn, '<axis xyz="0 0 2"/>'),
        ):
            n = len(parts) - 1
            parts.append(
                f'<joint name="{name}" type="{joint_type}"><parent link="l{n}"/>'
                f'<child link="l{n + 1}"/><origin {origin}/>{inner}'
                '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
            )
    links = "".join(f'<link name="l{n}"/>' for n in range(len(parts)))
    return f'<robot name="psm">{links}{"".join(parts)}{extra}</robot>'


def test_the_tool_errs_as_with_a_fixed_offset(session, model, tmp_path):
    (tmp_path / "psm.urdf").write_text(document())
    offsets, left_out = export_urdf(model, tmp_path / "psm.urdf", tmp_path / "new.urdf")
    assert "<!-- of a PSM -->" in (tmp_path / "new.urdf").read_text()
    baseline, test = model.baselines["offset"], session[1]
    expected = baseline.correct(test) - test.columns("measured", model.joints)
    np.testing.assert_allclose([*offsets.values()], expected[0], rtol=0, atol=1e-12)
    kinds = {f"PSM1_{joint.name}": joint.kind for joint in test.robot.joints[:6]}
    old, new = (read_urdf(tmp_path / f"{name}.urdf", kinds) for name in ("psm", "new"))
    reported = test.columns("measured", model.joints)
    true, corrected = test.columns("truth", model.joints), baseline.correct(test)
    tool = np.array([pose[:3, 3] for pose in map(new.forward, reported)])
    by_offset = np.array([pose[:3, 3] for pose in map(old.forward, corrected)])
    np.testing.assert_allclose(tool, by_offset, rtol=0, atol=1e-9)
    place = np.array([pose[:3, 3] for pose in map(old.forward, true)])
    raw = np.array([pose[:3, 3] for pose in map(old.forward, reported)])
    assert np.linalg.norm(tool - place, axis=1).mean() < 0.6 * (
        np.linalg.norm(raw - place, axis=1).mean()
    )
    assert left_out.startswith("scale (")
    assert "outer_wrist_yaw -" in left_out
    assert left_out.endswith("coupling of joints, effort")


def test_a_joint_behind_each_one_adds_its_scale(session, model, tmp_path):
    (tmp_path / "psm.urdf").write_text(document())
    paths = [tmp_path / "offsets.urdf", tmp_path / "scales.urdf"]
    said = [export_urdf(model, tmp_path / "psm.urdf", p, scale=p is paths[1]) for p in paths]
    assert said[0][0] == said[1][0]
    assert said[1][1] == "coupling of joints, effort"
    kinds = {f"PSM1_{joint.name}": joint.kind for joint in session[1].robot.joints[:6]}
    behind = {f"{name}_scale": kind for name, kind in kinds.items()}
    old, plain = (read_urdf(path, kinds) for path in (tmp_path / "psm.urdf", paths[0]))
    both = read_urdf(paths[1], kinds | behind)
    root = ET.parse(paths[1]).getroot()  # noqa: S314 - our own
    mimics = {
        each.get("name"): each.find("mimic") for each in root if each.find("mimic") is not None
    }
    assert [mimic.get("joint") for mimic in mimics.values()] == [*kinds]
    reported = session[1].columns("measured", model.joints)
    factor, shift = (
        np.array([float(mimics[name].get(key)) for name in behind])
        for key in ("multiplier", "offset")
    )
    learnt, true = (session[0].columns(name, model.joints) for name in ("measured", "truth"))
    slopes = [np.polyfit(q, t, 1)[0] for q, t in zip(learnt.T, true.T, strict=True)]
    np.testing.assert_allclose(factor, np.array(slopes) - 1.0, rtol=0, atol=1e-9)
    middle = (learnt.min(axis=0) + learnt.max(axis=0)) / 2.0
    np.testing.assert_allclose(factor * middle + shift, 0.0, rtol=0, atol=1e-12)
    values = reported * (1.0 + factor) + shift + np.array([*said[0][0].values()])
    for row, follows, scaled in zip(reported, reported * factor + shift, values, strict=True):
        pose = both.forward(np.concatenate([row, follows]))
        np.testing.assert_allclose(pose, old.forward(scaled), rtol=0, atol=1e-9)
    ignored = both.forward(np.concatenate([row, np.zeros(6)]))
    np.testing.assert_allclose(ignored, plain.forward(row), rtol=0, atol=1e-9)
    wrist, truth = slice(4, 6), session[1].columns("truth", model.joints)
    before = model.baselines["offset"].correct(session[1])
    rmse = [np.sqrt(np.mean((x - truth)[:, wrist] ** 2, axis=0)) for x in (values, before)]
    assert (rmse[0] < 0.9 * rmse[1]).all()
    for limit in root.iter("limit"):
        assert float(limit.get("lower")) <= float(limit.get("upper"))


MIMIC = (
    '<joint name="back" type="revolute"><parent link="l0"/><child link="b"/>'
    '<mimic joint="PSM1_outer_pitch" multiplier="-1"/></joint>'
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document(prefix="PSM1"), "no joint called 'outer_yaw'"),
        (document(extra='<joint name="x_outer_yaw" type="fixed"/>'), "no joint called 'outer_yaw'"),
        (document(outer_yaw="prismatic"), "joint 'PSM1_outer_yaw' is prismatic; want revolute"),
        (document(outer_insertion="fixed"), "joint 'PSM1_outer_insertion' is fixed; want prism"),
        (document(extra=MIMIC), "back with a mimic of or by 'PSM1_outer_pitch'"),
        (document().replace('xyz="0 0 2"', 'xyz="0 0 0"'), "its axis has no direction"),
        (document().replace('xyz="0 0 2"', 'xyz="0 0"'), "cannot be read as a URDF"),
        (document().replace('xyz="0 0 2"', 'xyz="a b c"'), "cannot be read as a URDF"),
        (document().replace('xyz="0 0 2"', 'xyz="0 nan 0"'), "or a number is not finite"),
        ("<robot", "cannot be read as a URDF"),
        ("<sdf/>", "no joint called 'outer_yaw'; known: none"),
        ('<!DOCTYPE r [<!ENTITY e "x">]><robot name="&e;"/>', "no document type or CDATA is read"),
        ('<!DOCTYPE r [<!ENTITY e "x">]><robot name="&e;"/>\ufeff', "cannot be read as a URDF"),
    ],
)
def test_a_urdf_that_cannot_say_it_is_refused(model, tmp_path, text, message):
    encoding = "utf-16" if text.endswith("\ufeff") else "utf-8"  # which would hide entities
    (tmp_path / "psm.urdf").write_text(text, encoding=encoding)
    with pytest.raises(ExportError, match=message):
        export_urdf(model, tmp_path / "psm.urdf", tmp_path / "new.urdf")
    assert not (tmp_path / "new.urdf").exists()


def test_offsets_that_say_nothing_are_refused(session, tmp_path):
    run_ = session[0]
    still = {
        f"truth/{joint}": run_.column(f"truth/{joint}") - run_.error([joint]).mean()
        for joint in run_.robot.positioning
    }
    none = calibrate(type(run_)(run_.table.assign(**still), run_.units, run_.provenance), "linear")
    (tmp_path / "psm.urdf").write_text(document())
    with pytest.raises(ExportError, match="fixed offsets are below 5 % of the errors in training"):
        export_urdf(none, tmp_path / "psm.urdf", tmp_path / "new.urdf")


def test_the_command_says_what_a_urdf_leaves_out(model, tmp_path):
    (tmp_path / "psm.urdf").write_text(document(prefix=""))
    write_calibration(model, tmp_path / "m.safetensors")
    words = (tmp_path / "m.safetensors", "--to", "urdf", "--out", tmp_path / "new.urdf")
    said = json.loads(run(*words, "--urdf", tmp_path / "psm.urdf", "--json").output)
    assert said["offsets"].keys() == set(model.joints)
    assert said["left_out"].startswith("scale")
    for wrong, message in (
        (("--urdf", tmp_path / "psm.urdf"), "exists"),
        ((), "--to urdf needs --urdf"),
        (("--urdf", "x.urdf", "--compensate"), "--to urdf takes --urdf"),
    ):
        assert message in str(run(*words, *wrong).exception)
    other = (tmp_path / "m.safetensors", "--to", "c", "--out", tmp_path / "c")
    assert "--urdf is for --to urdf" in str(run(*other, "--urdf", "x.urdf").exception)
    scaled = [{"urdf": "scaled-urdf"}.get(word, word) for word in words]
    said = run(*scaled, "--urdf", tmp_path / "psm.urdf", "--force")
    assert "left out: coupling of joints, effort" in said.output
    assert "_scale" in (tmp_path / "new.urdf").read_text()
