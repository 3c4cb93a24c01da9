"""A URDF of the user's with the fixed offsets of a calibration in its joints."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
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
    overwrite: bool = False,
) -> tuple[dict[str, float], str]:
    """Write a URDF anew with each joint's fixed offset in its origin, and say what that leaves out.

    At reported positions its tool then errs as with the ``offset`` baseline. A joint is called as
    the calibration's, or ends in ``_`` and that name; all else stays. Gives the offset of each
    joint [rad or m], and in words what of the calibration a URDF cannot hold. Raises ExportError if
    the file is no URDF, lacks a joint, or has it of another type or in a mimic; and if the offsets
    say little of the errors.

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
    offsets, left_out = _linear_part(calibration)
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314
    try:  # without entities
        root = ET.fromstring(urdf_bytes(Path(urdf), ExportError).decode(), parser)  # noqa: S314
        for joint, offset in offsets.items():
            _shift(root, joint, calibration.machine.joint(joint).kind, offset)
    except (ET.ParseError, ValueError) as error:
        raise ExportError(f"{urdf}: cannot be read as a URDF ({words(error, 120)})") from None
    except LookupError as error:
        raise ExportError(f"{urdf}: {error.args[0]}") from None
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(
        path, lambda part: part.write_bytes(text), overwrite=overwrite, error=ExportError
    )
    return offsets, left_out


def _linear_part(calibration: Calibration) -> tuple[dict[str, float], str]:
    """Give the fixed offset of each joint [rad or m], and what of the calibration it is not."""
    joints, names = calibration.joints, calibration.feature_set.names
    half = (calibration.upper - calibration.lower) / 2
    middle = calibration.lower + half

    def baseline(name: str, X: Array) -> Array:
        model = calibration.baselines[name]
        memory = model.family.memory(model.fitted, len(names), len(joints))
        steps = np.zeros(len(X))
        return evaluate(model.family, memory, X, steps, len(joints)) + model.output_shift

    offset, domain = baseline("offset", middle[None])[0], calibration.training_domain
    largest = 0.0 if domain is None else np.maximum(-domain.error_lower, domain.error_upper)
    if (np.abs(offset) < _LEAST * largest).all():
        raise ExportError(
            f"fixed offsets are below {100 * _LEAST:g} % of the errors in training of "
            f"{', '.join(joints)}, and a URDF holds nothing else; correct by the model itself"
        )
    parts, measured = [], [f"measured/{joint}" for joint in joints]
    if "linear" in calibration.baselines and {*measured} <= {*names}:
        columns = [names.index(name) for name in measured]
        up, down = (baseline("linear", middle + s * np.diag(half)) for s in (1.0, -1.0))
        scales = np.diag((up - down)[columns]) / (2.0 * half[columns])
        percents = [f"{j} {100 * s:+.1f} %" for j, s in zip(joints, scales, strict=True)]
        parts.append(f"scale ({', '.join(percents)})")
    signals = calibration.feature_set.signals
    parts += ["coupling of joints"] if len(joints) > 1 else []
    parts += ["effort"] if any(name.startswith("effort/") for name in signals) else []
    parts += ["history"] if calibration.looks_back else []
    parts += ["curvature"] if calibration.estimator not in ("offset", "linear") else []
    return dict(zip(joints, offset.tolist(), strict=True)), ", ".join(parts)


def _shift(root: ET.Element, joint: str, kind: str, offset: float) -> None:
    """Add an offset [rad or m] to a joint's origin; raises LookupError where it cannot be."""
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
