"""Conditions that a scenario may add to calm water and exact sensors: one module each, and shared helpers."""
