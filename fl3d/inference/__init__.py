"""Run trained detectors: load a checkpoint, detect, collect windows."""
