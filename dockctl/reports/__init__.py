"""Figures of runs, scenarios and timings; matplotlib lives here, and nothing here simulates or learns."""
