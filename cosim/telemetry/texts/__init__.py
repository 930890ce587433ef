"""Texts from a summary: sentences, warnings, tables."""
