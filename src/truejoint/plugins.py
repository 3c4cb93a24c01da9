"""Robots, formats, estimators and models of other installed packages, by name."""

from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from truejoint.errors import TruejointError

if TYPE_CHECKING:  # a shell that completes a word waits for what is imported
    from importlib.metadata import EntryPoint

Group = Literal["truejoint.robots", "truejoint.formats", "truejoint.estimators", "truejoint.models"]


@cache
def plugins(group: Group, taken: tuple[str, ...] = ()) -> "dict[str, EntryPoint]":
    """Entry points of a group by name, none of them loaded yet.

    Without the names that two packages claim, or that are `taken` by truejoint's own; a warning
    names them once.
    """
    import logging  # noqa: PLC0415
    from importlib.metadata import entry_points  # noqa: PLC0415

    claims: defaultdict[str, list[EntryPoint]] = defaultdict(list)
    for point in entry_points(group=group):
        claims[point.name].append(point)
    usable = {}
    for name, points in claims.items():
        if len(points) == 1 and name not in taken:
            usable[name] = points[0]
            continue
        packages = " and ".join(_package(point) for point in points)
        used = "that of truejoint" if name in taken else "none of them"
        logging.getLogger("truejoint").warning(
            "%s %r of %s: the name is taken, %s is used; uninstall what you do not need",
            group, name, packages, used,
        )  # fmt: skip
    return usable


def load_plugin(point: "EntryPoint", kinds: type | tuple[type, ...]) -> Any:
    """Load what an entry point names.

    Raises TruejointError, with package and cause, if it cannot be imported or is none of `kinds`.
    """
    loaded = call_plugin(point, point.load)
    if not isinstance(loaded, kinds):
        what = type(loaded).__name__
        raise TruejointError(f"{origin(point)} is a {what}, which is of no use there")
    return loaded


def call_plugin(
    point: "EntryPoint", function: Callable[..., Any], *arguments: Any, **named: Any
) -> Any:
    """Call `function` of the package behind an entry point, which may raise anything.

    Raises the function's own TruejointError, or one that names package, first argument and cause.
    """
    try:
        return function(*arguments, **named)
    except TruejointError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001  # code of others
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        on = f" with {arguments[0]}" if arguments and arguments[0] else ""
        raise TruejointError(
            f"{origin(point)} does not work{on} ({cause}); mend or uninstall it"
        ) from None


def origin(point: "EntryPoint") -> str:
    """Group, name and package of an entry point, for a message."""
    return f"{point.group} {point.name!r} of package {_package(point)}"


def _package(point: "EntryPoint") -> str:
    return point.dist.name if point.dist is not None else point.value
