from .check import CalibrationCheck as CalibrationCheck
from .check import check_calibration as check_calibration
from .corrector import Corrector as Corrector
from .monitor import Alarm as Alarm
from .monitor import Monitor as Monitor
from .monitor import Reason as Reason
from .rezero import ReZero as ReZero
from .status import Status as Status
