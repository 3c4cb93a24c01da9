"""truejoint tells where a cable-driven joint really is.

Read recordings, calibrate, correct and judge::

    import truejoint

    training = [truejoint.read_recording("zigzag.parquet")]
    model = truejoint.calibrate(training, "dnn")
    corrected = model.correct(truejoint.read_recording("motion.parquet"))
"""

import lazy_loader

# Imported on first use; the names stand in the stub beside this file.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
