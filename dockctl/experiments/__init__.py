"""Trainings and studies from start to run folder: start, resume, export, archive."""
