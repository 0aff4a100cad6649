"""Telling somebody's server that a job has changed."""
