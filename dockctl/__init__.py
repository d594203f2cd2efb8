"""dockctl: teach a small underactuated boat to dock in reverse, and measure how well it does."""

__version__ = "0.1.0"
