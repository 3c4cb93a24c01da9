"""A calibration as source that needs no Python: C99 and ONNX."""
