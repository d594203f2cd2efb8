"""The harbor and the boat in plan view: data and colors, shared by figures and rendered frames."""
