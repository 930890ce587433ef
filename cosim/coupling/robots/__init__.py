"""What may represent the soft body in the exchange: the film, a section model, a frozen shape."""
