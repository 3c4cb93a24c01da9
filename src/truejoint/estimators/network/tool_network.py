"""A network that was trained on the tool's position: it runs as any network."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.estimators.network import run as network

FAMILY: Final = replace(network.FAMILY, name="tool_network")
