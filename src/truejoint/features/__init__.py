"""Features: texts that say what a model takes of a recording, computed alike offline and online."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
