"""One stage: from a parent checkpoint, or from nothing, to its last epoch."""
