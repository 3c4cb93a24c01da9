"""A URDF of the user's with the fixed offsets of a calibration in its joints."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.errors import ExportError, unknown, words
from truejoint.estimators.family import evaluate
from truejoint.files import check_ending, write_atomically
from truejoint.robots.urdf import KINDS, urdf_bytes

_LEAST: Final = 0.05  # of the largest error in training, that an offset is at least


def export_urdf(
    calibration: Calibration,
    urdf: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    scale: bool = False,
    overwrite: bool = False,
) -> tuple[dict[str, float], str]:
    """Write a URDF anew with each joint's fixed offset in its origin, and say what that leaves out.

    At reported positions its tool then errs as with the ``offset`` baseline. A joint is called as
    the calibration's, or ends in ``_`` and that name; all else stays. With `scale` a joint
    ``<name>_scale`` behind each one mimics it and adds its scale; a reader that knows no mimic
    leaves that at 0. Gives the offset of each joint [rad or m], and in words what of the
    calibration the URDF does not hold. Raises ExportError if the file is no URDF, lacks a joint, or
    has it of another type or in a mimic; and if the offsets say little of the errors.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = '<robot name="r"><joint name="jaw" type="revolute"/></robot>'
    >>> _ = Path("jaw.urdf").write_text(text)
    >>> list(export_urdf(model, "jaw.urdf", "calibrated.urdf")[0])
    ['jaw']
    """
    calibration, path = as_calibration(calibration), Path(path)
    check_ending(path, ".urdf", "a URDF", ExportError)
    offsets, scales, left_out = _linear_part(calibration, scale)
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314
    try:  # without entities
        root = ET.fromstring(urdf_bytes(Path(urdf), ExportError).decode(), parser)  # noqa: S314
        for joint, offset in offsets.items():
            element = _shift(root, joint, calibration.machine.joint(joint).kind, offset)
            if scale:
                _follow(root, element, *scales[joint])
    except (ET.ParseError, ValueError) as error:
        raise ExportError(f"{urdf}: cannot be read as a URDF ({words(error, 120)})") from None
    except LookupError as error:
        raise ExportError(f"{urdf}: {error.args[0]}") from None
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(path, text, overwrite=overwrite, error=ExportError)
    return offsets, left_out


def _linear_part(
    calibration: Calibration, scale: bool
) -> tuple[dict[str, float], dict[str, Sequence[float]], str]:
    """Give each joint's offset [rad or m], its scale and about which position, and what is left.

    A scale is the slope of truth over measured in the training, less 1.
    """
    joints, n_features = calibration.joints, len(calibration.feature_set.names)
    model, domain = calibration.baselines["offset"], calibration.training_domain
    memory, row = model.family.memory(model.fitted, n_features, len(joints)), np.zeros(n_features)
    error = evaluate(model.family, memory, row[None], np.zeros(1), len(joints))[0]
    offset = error + model.output_shift
    largest = 0.0 if domain is None else np.maximum(-domain.error_lower, domain.error_upper)
    if not scale and (np.abs(offset) < _LEAST * largest).all():
        raise ExportError(
            f"fixed offsets are below {100 * _LEAST:g} % of the errors in training of "
            f"{', '.join(joints)}, and a URDF holds nothing else; correct by the model itself"
        )
    scales = {}
    for joint in joints:
        conditions = [c for s in calibration.origin.sessions for c in s.conditions]
        rows = [(c.slope - 1.0, c.middle, c.range) for c in conditions if c.joint == joint]
        told = np.array([row for row in rows if np.isfinite(row).all()] or [(0.0, 0.0, 1.0)])
        scales[joint] = np.average(told[:, :2], axis=0, weights=told[:, 2]).tolist()
    percents = ", ".join(f"{joint} {100 * each:+.1f} %" for joint, (each, _) in scales.items())
    parts = [] if scale else [f"scale ({percents})"]
    signals = calibration.feature_set.signals
    parts += ["coupling of joints"] if len(joints) > 1 else []
    parts += ["effort"] if any(name.startswith("effort/") for name in signals) else []
    parts += ["history"] if calibration.looks_back else []
    parts += ["curvature"] if calibration.estimator not in ("offset", "linear") else []
    return dict(zip(joints, offset.tolist(), strict=True)), scales, ", ".join(parts)


def _shift(root: ET.Element, joint: str, kind: str, offset: float) -> ET.Element:
    """Add an offset [rad or m] to a joint's origin, and give it; else raises LookupError."""
    joints = {str(each.get("name")): each for each in root.iter("joint") if each.get("type")}
    alike = [n for n in joints if n == joint] or [n for n in joints if n.endswith(f"_{joint}")]
    if len(alike) != 1:
        raise LookupError(unknown("joint", joint, joints))
    name, element = alike[0], joints[alike[0]]
    if KINDS.get(str(element.get("type"))) != kind:
        raise LookupError(f"joint {name!r} is {element.get('type')}; want {kind}")
    mimics = [n for n, e in joints.items() for m in e.iter("mimic") if name in (n, m.get("joint"))]
    if mimics:
        raise LookupError(
            f"{', '.join(mimics)} with a mimic of or by {name!r}, which cannot follow an offset; "
            "give a URDF without mimic joints there"
        )
    origin, axis = element.find("origin"), element.find("axis")
    origin = ET.SubElement(element, "origin") if origin is None else origin
    z = np.array(("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split(), float)
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    if not (np.isfinite([xyz, rpy, z]).all() and np.linalg.norm(z) > 0.0):
        raise LookupError(f"joint {name!r}: its axis has no direction, or a number is not finite")
    z, turn = offset * z / np.linalg.norm(z), Rotation.from_euler("xyz", rpy)
    if kind == "prismatic":
        xyz = xyz + turn.apply(z)
    else:
        turn = turn * Rotation.from_rotvec(z)
    for key, values in (("xyz", xyz), ("rpy", turn.as_euler("xyz"))):
        origin.set(key, " ".join(f"{value:.15g}" for value in values))
    return element


def _follow(root: ET.Element, joint: ET.Element, scale: float, middle: float) -> None:
    """Put a joint behind another, that turns by `scale` of how far that is from `middle`."""
    name, link, behind = f"{joint.get('name')}", f"{joint.get('name')}_unscaled", deepcopy(joint)
    behind.set("name", f"{name}_scale")
    for each in [each for each in behind if each.tag not in ("child", "axis", "limit")]:
        behind.remove(each)
    for limit in behind.iter("limit"):
        ends = (scale * (float(limit.get(key, "0")) - middle) for key in ("lower", "upper"))
        limit.attrib.update(zip(("lower", "upper"), map(str, sorted(ends)), strict=True))
    for child in joint.iter("child"):
        child.set("link", link)
    ET.SubElement(behind, "parent", link=link)
    ET.SubElement(behind, "mimic", joint=name, multiplier=f"{scale}", offset=f"{-scale * middle}")
    root.extend([ET.Element("link", name=link), behind])
