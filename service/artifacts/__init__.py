"""Inputs and results as files."""
