"""Scenario files: YAML, validated against frozen models."""
