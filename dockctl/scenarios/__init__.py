"""Scenarios as data: YAML files checked against frozen models."""
