"""Rewards: registered terms measure a control step, and the scenario weights them."""
