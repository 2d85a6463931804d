"""Scores in MLflow; no other room knows MLflow."""
