"""Contact forces between the film and the scene's bodies, in both directions."""
