from .pages import ArmPage as ArmPage
from .pages import RecordingPage as RecordingPage
