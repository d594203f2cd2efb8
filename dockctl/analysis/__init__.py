"""Numbers from tables of episodes, without drawing."""
