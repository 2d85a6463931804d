"""Figures, drawn from data frames and arrays: PNG and PDF, the data beside."""
