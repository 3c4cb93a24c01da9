"""Published experiments and our own: one shape, one runner, one page.

A study is a line of data (`Study`) and a module that names its parts and makes a summary of them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
