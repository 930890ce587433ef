"""The energy of a section model, term by term, and the shapes that it shows."""
