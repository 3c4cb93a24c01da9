"""An arm that speaks CRTK's names, over interchangeable back ends."""

import lazy_loader

# Imported on first use; the names stand in the stub beside this file.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
