"""Digital twins: robots that err the way the real ones do, compiled and deterministic."""
