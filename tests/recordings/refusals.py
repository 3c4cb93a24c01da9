"""What is refused is refused in one line."""

from collections.abc import Callable
from typing import Any

import pytest

from truejoint.errors import RecordingError


def refused(said: str, call: Callable[..., object], *args: Any, **options: Any) -> str:
    """Refuse a call in one line in which that is said; the line."""
    with pytest.raises(RecordingError, match=said) as caught:
        call(*args, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message
