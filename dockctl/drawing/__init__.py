"""Plan view of the harbor and the boat: data, strokes and colors, shared by figures and rendered frames."""
