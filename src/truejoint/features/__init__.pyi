from .feature_set import Feature as Feature
from .feature_set import FeatureSet as FeatureSet
from .feature_set import default_features as default_features
from .feature_set import default_gap_limit as default_gap_limit
from .feature_set import sample_dt as sample_dt
from .feature_set import time_steps as time_steps
