"""Numbers from tables: pure functions, without simulation and without drawing."""
