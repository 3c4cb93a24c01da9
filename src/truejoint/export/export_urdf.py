"""A URDF of the user's with the fixed offsets of a calibration in its joints."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
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
_SCALE: Final = 1e-3  # of a joint's travel, from which on a scale is worth a word


def export_urdf(
    calibration: Calibration,
    urdf: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> tuple[dict[str, float], str]:
    """Write a URDF anew with each joint's fixed offset in its origin, and say what that leaves out.

    True positions are then those of the URDF at reported ones, as far as an offset goes: the tool
    errs as with the ``offset`` baseline. A joint of the URDF is called as the calibration's, or
    ends in ``_`` and that name. All else stays, limits too, which are of reported positions.

    Returns
    -------
    offsets : dict
        Offset of each joint that was added [rad or m].
    left_out : str
        Parts of the calibration that a URDF cannot hold.

    Raises
    ------
    ExportError
        If the file is no URDF, lacks a joint, has it of another type or in a mimic, or the offsets
        say little of what the calibration corrects.

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
    offsets, scales = _linear_part(calibration)
    root = _parsed(Path(urdf))
    for joint, offset in offsets.items():
        _shift(root, joint, calibration.units[f"measured/{joint}"], offset, str(urdf))
    text = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(
        path, lambda part: part.write_bytes(text), overwrite=overwrite, error=ExportError
    )
    return offsets, _left_out(calibration, scales)


def _linear_part(calibration: Calibration) -> tuple[dict[str, float], dict[str, float]]:
    """Give the fixed offset [rad or m] and the scale of each joint, by the baselines."""
    joints, n = calibration.joints, len(calibration.joints)
    middle = (calibration.lower + calibration.upper) / 2

    def baseline(name: str, X: Array) -> Array:
        model = calibration.baselines[name]
        memory = model.family.memory(model.fitted, len(middle), n)
        return evaluate(model.family, memory, X, np.zeros(len(X)), n) + model.output_shift

    offset, domain = baseline("offset", middle[None])[0], calibration.training_domain
    if domain is not None:
        largest = np.maximum(np.abs(domain.error_lower), np.abs(domain.error_upper))
        if (np.abs(offset) < _LEAST * largest).all():
            raise ExportError(
                f"fixed offsets are below {100 * _LEAST:g} % of the errors in training of "
                f"{', '.join(joints)}, and a URDF holds nothing else; correct by the model itself"
            )
    scales = {}
    for k, joint in enumerate(joints):
        names = calibration.feature_set.names
        if "linear" in calibration.baselines and (own := f"measured/{joint}") in names:
            column = names.index(own)
            ends = np.tile(middle, (2, 1))
            ends[:, column] = calibration.lower[column], calibration.upper[column]
            scales[joint] = float(
                np.diff(baseline("linear", ends)[:, k])[0] / np.ptp(ends[:, column])
            )
    return dict(zip(joints, offset.tolist(), strict=True)), scales


def _parsed(path: Path) -> ET.Element:
    """Root of a URDF with its comments; raises ExportError."""
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))  # noqa: S314  # no entities
    try:
        root = ET.fromstring(urdf_bytes(path, ExportError).decode(), parser)  # noqa: S314
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise ExportError(f"{path}: cannot be read as a URDF ({words(error, 120)})") from None
    if root.tag != "robot":
        raise ExportError(f"{path}: begins with <{root.tag}>; a URDF begins with <robot>")
    return root


def _shift(root: ET.Element, joint: str, unit: str, offset: float, place: str) -> None:
    """Add an offset [rad or m] to a joint, in its origin."""
    elements = {str(each.get("name")): each for each in root.iter("joint") if each.get("type")}
    alike = [name for name in elements if name == joint] or [
        name for name in elements if name.endswith(f"_{joint}")
    ]
    if len(alike) != 1:
        raise ExportError(f"{place}: {unknown('joint', joint, elements)}")
    element, name = elements[alike[0]], alike[0]
    kind, wanted = KINDS.get(str(element.get("type"))), "prismatic" if unit == "m" else "revolute"
    if kind != wanted:
        raise ExportError(f"{place}: joint {name!r} is {element.get('type')}; want {wanted}")
    mimics = [
        n for n, e in elements.items() for m in e.iter("mimic") if name in (n, m.get("joint"))
    ]
    if mimics:
        raise ExportError(
            f"{place}: {', '.join(mimics)} with a mimic of or by {name!r}, which cannot follow an "
            "offset; give a URDF without mimic joints there"
        )
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    axis = element.find("axis")
    z = _numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), name, place)
    if not np.linalg.norm(z) > 0.0:
        raise ExportError(f"{place}: joint {name!r} has the axis {z.tolist()}; want a direction")
    z /= np.linalg.norm(z)
    xyz, rpy = (_numbers(origin.get(key, "0 0 0"), name, place) for key in ("xyz", "rpy"))
    turn = Rotation.from_euler("xyz", rpy)
    if unit == "m":
        xyz = xyz + turn.apply(offset * z)
    else:
        turn = turn * Rotation.from_rotvec(offset * z)
    for key, values in (("xyz", xyz), ("rpy", turn.as_euler("xyz"))):
        origin.set(key, " ".join(f"{value:.15g}" for value in values))


def _numbers(text: str, name: str, place: str) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ExportError(f"{place}: joint {name!r} has {text!r:.60}; want three numbers")
    return values


def _left_out(calibration: Calibration, scales: Mapping[str, float]) -> str:
    """Say what of a calibration a fixed offset is not."""
    told = [f"{j} {100 * s:+.1f} %" for j, s in scales.items() if abs(s) > _SCALE]
    signals = calibration.feature_set.signals
    parts = [f"scale ({', '.join(told)})"] if told else []
    parts += ["coupling of joints"] if len(calibration.joints) > 1 else []
    parts += ["effort"] if any(name.startswith("effort/") for name in signals) else []
    parts += ["history"] if calibration.looks_back else []
    parts += ["curvature"] if calibration.estimator not in ("offset", "linear") else []
    return ", ".join(parts) or "nothing"
