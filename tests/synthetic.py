"""Small synthetic recordings."""

from dataclasses import replace
from typing import Any

import numpy as np

from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot


def build_recording(
    n: int = 1500, seed: int = 0, *, rate: float = 30.0, **origin: str
) -> Recording:
    """Smooth random motion of all joints; the error is an offset, a slope and a play in effort."""
    rng = np.random.default_rng(seed)
    robot = get_robot("raven2", origin.get("arm", "left"))
    t = np.cumsum(rng.uniform(0.8, 1.2, n)) / rate
    columns = {"t": t}
    for channel in robot.channels:
        if channel in robot.unused_channels:
            columns[f"measured/{channel}"] = columns[f"effort/{channel}"] = np.zeros(n)
            continue
        frequency, phase = rng.uniform(0.1, 0.6, 3), rng.uniform(0, 6, 3)
        waves = np.sin(2 * np.pi * np.outer(t, frequency) + phase)
        columns[f"measured/{channel}"] = 0.5 + 0.1 * waves.sum(axis=1)
        columns[f"effort/{channel}"] = np.tanh(np.gradient(waves[:, 0], t)) + rng.normal(0, 0.05, n)
    for k, joint in enumerate(robot.positioning):
        q, effort = columns[f"measured/{joint}"], columns[f"effort/{joint}"]
        error = 0.02 * (k + 1) + 0.05 * (q - 0.5) - 0.004 * effort + 0.1 * (q - 0.5) ** 2
        columns[f"truth/{joint}"] = q + error + rng.normal(0, 1e-4, n)
    provenance = Provenance(
        "raven2", source=f"synthetic-{seed}", session=f"s{seed}", homing_id="h1"
    )
    units = {f"effort/{channel}": "Nm" for channel in robot.channels}
    return Recording.from_columns(columns, replace(provenance, **origin), units)


def make_recording(
    robot: str = "raven2",
    arm: str = "",
    *,
    seconds: float = 30.0,
    rate: float = 30.0,
    seed: int = 0,
    effort: bool = True,
    source: str = "",
    **provenance: Any,
) -> Recording:
    """Sinusoids on every joint; the truth lags behind the motor side by stretch and play."""
    random = np.random.default_rng(seed)
    model = get_robot(robot, arm)
    t = np.arange(round(seconds * rate)) / rate
    columns: dict[str, np.ndarray] = {"t": t}
    truths = {}
    for joint in model.joints:
        scale = 0.5 if joint.unit == "rad" else 0.04
        centre = 1.0 if joint.unit == "rad" else 0.38
        speed, phase = random.uniform(0.4, 1.2), random.uniform(0, 6)
        position = centre + scale * np.sin(speed * t + phase) * np.cos(0.13 * t)
        way = np.tanh(8 * np.gradient(position, t) / scale)
        load = np.cos(position) + 0.4 * way
        columns[f"measured/{joint.name}"] = position
        if effort:
            columns[f"effort/{joint.name}"] = load + random.normal(0, 0.02, len(t))
        noise = random.normal(0, 0.002 * scale, len(t))
        truths[joint.name] = position - scale * (0.05 + 0.02 * load + 0.01 * way) + noise
    for name in model.positioning:
        columns[f"truth/{name}"] = truths[name]
    information = Provenance(
        robot=model.name, arm=model.arm, source=source or f"synthetic-{seed}.csv", **provenance
    )
    units = {f"effort/{joint.name}": joint.effort_unit for joint in model.joints} if effort else {}
    return Recording.from_columns(columns, information, units)


def jaw_motion(seed: int, **about: Any) -> Recording:
    """Four seconds of a jaw whose cable stretches with its effort."""
    random = np.random.default_rng(seed)
    t = np.arange(400) / 100
    jaw = 0.5 + 0.3 * np.sin(2 * t + random.uniform(0, 6)) * np.sin(5 * t)
    effort = 0.02 * np.cos(3 * t + random.uniform(0, 6)) + 1e-3 * random.standard_normal(400)
    truth = 1.02 * jaw + 0.5 * effort + 0.01 + 1e-4 * random.standard_normal(400)
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    about = {"source": f"motion_{seed}.csv", "session": str(seed), **about}
    return Recording.from_columns(columns, Provenance("davinci_grasper", **about))
