"""Contact of the film with the scene's objects and with itself."""
