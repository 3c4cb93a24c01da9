"""The experiments of yan2020 on virtual forceps, and past them."""

from truejoint.evaluation.forceps.forces import Forces, compare_forces
from truejoint.evaluation.forceps.homing import Homing, compare_homing
from truejoint.evaluation.forceps.loaded import LoadCase, Loaded, compare_loaded
from truejoint.evaluation.forceps.methods import METHODS, Method, fit_methods
from truejoint.evaluation.forceps.population import PopulationStudy, study_population
from truejoint.evaluation.forceps.strategies import Strategies, compare_strategies
from truejoint.evaluation.forceps.unloaded import Unloaded, compare_unloaded

__all__ = [
    "METHODS",
    "Forces",
    "Homing",
    "LoadCase",
    "Loaded",
    "Method",
    "PopulationStudy",
    "Strategies",
    "Unloaded",
    "compare_forces",
    "compare_homing",
    "compare_loaded",
    "compare_strategies",
    "compare_unloaded",
    "fit_methods",
    "study_population",
]
