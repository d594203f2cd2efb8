"""Rewards: registered terms measure a control step, the scenario's weights judge it."""
