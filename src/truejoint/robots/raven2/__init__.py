"""RAVEN-II, the cable-driven surgical research robot: both arms, and its hardware's numbers."""

from truejoint.robots.raven2.hardware import build as build
