"""Message classes of Cyclone DDS that are on the wire what ROS 2's are, made from definitions."""

import dataclasses
import os
from collections.abc import Callable
from functools import cache
from types import new_class
from typing import Any, Final

import cyclonedds.idl
import cyclonedds.idl.annotations
import cyclonedds.idl.types
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from truejoint.crtk.messages import DEFINITIONS, SERVICES, ros2_definition
from truejoint.errors import RosError

_types: Any = cyclonedds.idl.types  # whose annotations say that nothing can be given a length
_INTEGERS: Final = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_BASIC: Final = {
    "bool": (bool, False),
    "string": (str, ""),
    **dict.fromkeys(("byte", "char", "octet"), (_types.uint8, 0)),
    **{name: (getattr(_types, name), 0) for name in _INTEGERS},
    **{name: (getattr(_types, name), 0.0) for name in ("float32", "float64")},
}
_Field = tuple[Any, Callable[[], Any]]
# rmw_cyclonedds_cpp puts these before each request and response.
_CALL: Final[dict[str, _Field]] = {
    "client_guid": (_types.uint64, int),
    "sequence_number": (_types.int64, int),
}


@cache
def definitions() -> Any:
    """Every definition that rosbags brings of the sourced ROS 2, or the latest, and ours."""
    distribution = f"ROS2_{os.environ.get('ROS_DISTRO', '').upper()}"
    store = get_typestore(getattr(Stores, distribution, Stores.LATEST))
    for kind in DEFINITIONS:
        store.register(get_types_from_msg(ros2_definition(kind), kind.replace("/", "/msg/")))
    for kind, (_, *texts) in SERVICES.items():
        for half, text in zip(("Request", "Response"), texts, strict=True):
            (definition,) = get_types_from_msg(text, half).values()
            store.register({f"{kind.replace('/', '/srv/')}_{half}": definition})
    return store


@cache
def message_class(name: str, *, is_call: bool = False) -> type[Any]:
    """Class of messages of a type that is called as ROS 2 does, ``sensor_msgs/msg/JointState``.

    A message is made empty, and its fields can be set. ``TYPE_HASH`` is what ROS 2 tells variants
    of a type apart by (REP 2016). With `is_call` it begins with who calls a service, as between
    clients and servers on Cyclone DDS. Raises RosError for an unknown type.
    """
    if name not in definitions().fielddefs:
        raise RosError(f"truejoint has no definition of ROS 2's {name}")
    fields: dict[str, _Field] = dict(_CALL) if is_call else {}
    for field, (shape, of) in definitions().fielddefs[name][1]:
        fields[field] = _field(shape.name, of)
    package, kind, short = name.split("/")
    namespace = {
        "__annotations__": {field: hint for field, (hint, _) in fields.items()},
        "__module__": __name__,
        **{field: dataclasses.field(default_factory=empty) for field, (_, empty) in fields.items()},
        "TYPE_HASH": definitions().hash_rihs01(name),
    }
    typename = f"{package}::{kind}::dds_::{short}_"
    made = new_class(
        short, (cyclonedds.idl.IdlStruct,), {"typename": typename}, lambda it: it.update(namespace)
    )
    final: type[Any] = cyclonedds.idl.annotations.final(dataclasses.dataclass(made))
    return final


def _field(shape: str, of: Any) -> _Field:
    """Type of a field, and what makes its empty value, from how rosbags describes it."""
    if shape == "BASE":
        name, most = of
        hint, zero = _BASIC[name]
        return (_types.bounded_str[most] if most else hint), lambda: zero
    if shape == "NAME":
        made = message_class(of)
        return made, made
    (inner, what), count = of
    hint, empty = _field(inner.name, what)
    if shape == "ARRAY":
        return _types.array[hint, count], lambda: [empty() for _ in range(count)]
    return (_types.sequence[hint, count] if count else _types.sequence[hint]), list
