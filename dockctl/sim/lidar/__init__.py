"""Range sensors: rays, the exact fast scan and the full scan it is tested against."""
