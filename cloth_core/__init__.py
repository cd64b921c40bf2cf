"""Cloth simulation by particles and springs: patterns, garments, bodies, scenes and runs. Knows nothing of ROS."""
