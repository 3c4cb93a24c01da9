"""Optional packages: imported where they are needed, named where they are missing."""

from importlib import import_module
from typing import Any

from truejoint.errors import TruejointError


def require(module: str, extra: str, purpose: str) -> Any:
    """Import `module`, which `pip install "truejoint[extra]"` brings.

    Raises TruejointError that says for what `purpose` it is needed and how to install it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise TruejointError(
            f"{purpose} needs {error.name}, which is not installed: "
            f'pip install "truejoint[{extra}]"'
        ) from None
