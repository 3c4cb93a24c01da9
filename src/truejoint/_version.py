"""Version of the package that is installed, and of what its results depend on."""

import platform
from importlib.metadata import version
from typing import Final

__version__ = version("truejoint")
_PACKAGES: Final = ("truejoint", "numpy", "scipy", "numba", "scikit-learn", "pandas")


def versions() -> list[tuple[str, str]]:
    """Versions of Python and of the packages that a result depends on."""
    return [("Python", platform.python_version()), *((name, version(name)) for name in _PACKAGES)]
