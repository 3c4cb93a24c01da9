"""The wrist of a cable-driven instrument: pitch and two jaws, three motors, six cables."""

from truejoint.robots.wrist.instruments import build as build
