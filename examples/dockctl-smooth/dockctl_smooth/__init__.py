"""Smooth controls for dockctl; this package also holds the YAML files that it offers."""
