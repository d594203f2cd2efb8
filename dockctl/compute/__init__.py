"""Compilation, threads and cached tables."""
