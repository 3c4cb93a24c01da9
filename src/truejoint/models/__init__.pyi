from .features import Feature as Feature
from .features import FeatureSet as FeatureSet
from .features import default_features as default_features
from .features import default_gap_limit as default_gap_limit
from .features import sample_dt as sample_dt
from .features import time_steps as time_steps
