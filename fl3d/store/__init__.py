"""Scores in MLflow, which nothing outside knows: ``connection`` reaches it, ``tracking`` writes, ``reading`` reads."""
