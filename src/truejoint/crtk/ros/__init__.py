"""Topics of a running ROS, 1 or 2, and what an arm says on them."""

from truejoint.crtk.ros.state_stream import StateStream
from truejoint.crtk.ros.transport import Publisher, Transport, open_transport

__all__ = ["Publisher", "StateStream", "Transport", "open_transport"]
