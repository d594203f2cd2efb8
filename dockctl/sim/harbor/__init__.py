"""The harbor as closed solids, from a description or from mesh files."""
