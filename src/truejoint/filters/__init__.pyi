from .filter import FilterResult as FilterResult
from .filter import FilterState as FilterState
from .filter import SmoothedResult as SmoothedResult
from .filter import UnscentedFilter as UnscentedFilter
from .sigma_points import FilterError as FilterError
from .sigma_points import ScaledSigmaPoints as ScaledSigmaPoints
from .state_space import StateSpaceModel as StateSpaceModel
from .status import FilterStatus as FilterStatus
