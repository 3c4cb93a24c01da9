"""truejoint tells where a cable-driven joint really is.

Read recordings, calibrate, correct and judge::

    import truejoint

    training = [truejoint.read_recording("zigzag.parquet")]
    model = truejoint.calibrate(training, "dnn")
    corrected = model.correct(truejoint.read_recording("motion.parquet"))
"""


def __getattr__(name: str) -> object:
    """Import on first use what stands in the stub beside this file, which is read then, not now.

    So the command line comes to look after Ctrl-C a few milliseconds after the interpreter.
    """
    import lazy_loader  # noqa: PLC0415

    attached, *listed = lazy_loader.attach_stub(__name__, __file__)

    def get(name: str) -> object:
        if name not in listed[1]:
            from truejoint.summary import instead  # noqa: PLC0415

            raise AttributeError(f"truejoint has no {name!r:.60}{instead(name, listed[1])}")
        return attached(name)

    globals().update(zip(("__getattr__", "__dir__", "__all__"), (get, *listed), strict=True))
    return globals()[name] if name in globals() else get(name)


def __dir__() -> list[str]:
    __getattr__("__all__")
    return globals()["__dir__"]()
