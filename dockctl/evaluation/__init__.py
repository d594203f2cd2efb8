"""Everything that runs a policy, and the Python API for it."""
