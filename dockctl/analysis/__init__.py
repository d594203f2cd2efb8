"""Statistics of result tables: pure functions, no simulation, no drawing."""
