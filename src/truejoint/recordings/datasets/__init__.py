"""Public recordings of real joints: what there is, where it is, how to get and open it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
