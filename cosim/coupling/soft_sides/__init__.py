"""What may stand for the soft body in the exchange: the film, a section model, a frozen shape."""
