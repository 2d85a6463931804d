"""Scores in MLflow: ``tracking`` writes and is the only module that knows MLflow; ``reading`` brings them back."""
