"""Figures from run folders, scenarios and measurements; drawing only."""
