"""The LiDAR scan and the equations of motion on an NVIDIA GPU; for many boats at once."""
