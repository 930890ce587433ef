"""Exchange schemes between arm and soft robot: staggered with algorithmic mass, and iterated."""
