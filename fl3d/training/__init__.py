"""One stage: from a parent checkpoint, or from scratch, to its last epoch."""
