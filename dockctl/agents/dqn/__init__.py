"""Dueling double DQN: network, replay, update (thesis sections 3.2.4 to 3.2.6)."""
