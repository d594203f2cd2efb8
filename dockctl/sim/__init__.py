"""The simulated world: vessel, harbor, LiDAR, collisions and goals, batched over boats."""
