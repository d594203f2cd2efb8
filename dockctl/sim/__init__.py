"""The simulated world: vessel, harbour, LiDAR, collisions and goals, batched over boats."""
