"""What is refused is refused in one line."""

from collections.abc import Callable

import pytest

from truejoint.errors import CalibrationError


def refused(said: str, build: Callable[..., object], *args: object, **options: object) -> None:
    """Refuse in one line that says so."""
    with pytest.raises(CalibrationError, match=said) as caught:
        build(*args, **options)
    assert "\n" not in str(caught.value)
